"""What a guide asks for, and its words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.capture.guidance.poses import rim
from calib.core.arrays import FloatArray
from calib.geometry.board import Board
from calib.geometry.camera import Camera, project
from calib.geometry.poses import transform

Role = Literal["c1", "c2"]


@dataclass(frozen=True)
class AskedPose:
    """A pose to hold the board at.

    Parameters
    ----------
    role
        In whose picture the outline is drawn.
    corners_px
        Where the board's corners are to be, px, shape (corners, 2).
    outline_px
        The rim of the outer squares, px, shape (n, 2), closed.
    why
        In a line: where, how tilted, and what it brings.
    u_now, u_then
        What is still uncertain and what will be, in `unit`.
    needed
        What it is to be.
    unit
        "px" or "%".
    taken_px
        Where the boards of the pictures taken were: their four corners, px, shape (v, 4, 2).
    """

    role: Role
    corners_px: FloatArray
    outline_px: FloatArray
    why: str
    u_now: float
    u_then: float
    needed: float
    unit: str
    taken_px: FloatArray


def asked_for(
    role: Role,
    camera: Camera,
    board: Board,
    pose: FloatArray,
    *,
    u: tuple[float, float],
    needed: float,
    unit: str,
    taken: FloatArray,
) -> AskedPose:
    """Return what is asked for by a pose, camera from board, shape (6,).

    Parameters
    ----------
    u
        Before and after.
    taken
        Corners of the pictures taken, px, shape (v, corners, 2).
    """
    corners = project(camera, transform(pose, board.object_points()))
    around = _along(rim(board))
    outline = project(camera, transform(pose, around))
    now, then = (f"{value:.2g}" if value < 99.5 else f"{value:.0f}" for value in u)
    return AskedPose(
        role=role,
        corners_px=corners,
        outline_px=outline,
        why=f"{where(outline, camera.image_size)}, {tilt_words(pose)}: u {now} to {then} {unit}",
        u_now=u[0],
        u_then=u[1],
        needed=needed,
        unit=unit,
        taken_px=_ends(taken, board),
    )


def _ends(taken: FloatArray, board: Board) -> FloatArray:
    """Return the four outermost corners of pictures that show all of them, px, (v, 4, 2)."""
    last = board.columns * board.rows - 1
    ends: FloatArray = taken[:, [0, board.columns - 1, last, last - board.columns + 1]]
    return ends[np.isfinite(ends).all(axis=(1, 2))]


def _along(corners: FloatArray) -> FloatArray:
    """Return points along a closed outline, five a side: a lens bends it."""
    ends = np.roll(corners, -1, axis=0)
    share = np.arange(5)[:, None, None] / 5
    return np.asarray((corners + share * (ends - corners)).swapaxes(0, 1).reshape(-1, 3))


def where(outline: FloatArray, image_size: tuple[int, int]) -> str:
    """Return in words where in the picture an outline, px, shape (n, 2), is, and how large."""
    size = np.array(image_size, dtype=float)
    low, high = np.nanmin(outline, axis=0) / size, np.nanmax(outline, axis=0) / size
    spare = low - (1 - high)
    across = "" if abs(spare[0]) < 0.1 else ("left" if spare[0] < 0 else "right")
    down = "" if abs(spare[1]) < 0.1 else ("top" if spare[1] < 0 else "bottom")
    both = " ".join(word for word in (down, across) if word)
    place = f"{both} {'corner' if down and across else 'edge'}" if both else "middle"
    return f"{place}, {100 * float(np.max(high - low)):.0f} % of the picture"


def tilt_words(pose: FloatArray) -> str:
    """Return in words how the board of a pose is tilted against the picture."""
    angle = math.degrees(float(np.linalg.norm(pose[:3])))
    if angle < 5:
        return "facing the camera"
    # Turned about +x (right) the top comes nearer, about +y (down) the right side.
    x, y = pose[:2] / np.linalg.norm(pose[:3])
    side = "top" if x > 0.38 else "bottom" if x < -0.38 else ""
    flank = "left" if y < -0.38 else "right" if y > 0.38 else ""
    nearer = " ".join(word for word in (side, flank) if word)
    return f"{nearer} nearer by {angle:.0f} deg"
