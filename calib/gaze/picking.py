"""Which target is meant by who points at a picture: the nearest that could be gazed at.

What is pointed at is never measured: it names a target, which its own detector then finds.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.dataset.manifest import DICTIONARIES
from calib.gaze.plate import CORNERS, PlateCorner
from calib.gaze.target import Blob, Cross, Target, board_corners
from calib.geometry.board import Board
from calib.geometry.camera import Camera
from calib.images.detection.picture import Grey

REACH_SHARE: Final = 0.03
"""Of the picture's width: what lies further off is not meant."""

TAGS_SHARE: Final = 0.15
"""Of the picture's width: a tag that is meant lies within so much of the place, all of it."""


def target_near(
    grey: Grey, place: FloatArray, *, board: Board | None, lens: Camera | None
) -> str | None:
    """Return the name of the target nearest to a place in a picture; None if none is near.

    Parameters
    ----------
    grey
        The picture, shape (height, width).
    place
        Where it is pointed at, px, shape (2,).
    board
        Of the rig, if it has one.
    lens
        Of the camera, if it is known.
    """
    reach = REACH_SHARE * grey.shape[1]
    seen = [*_seen(grey, board, lens), *_tags(grey, place)]
    found = [(float(np.hypot(*(at - place))), name) for name, at in seen]
    near = [one for one in found if one[0] <= reach]
    return min(near)[1] if near else None


def _seen(grey: Grey, board: Board | None, lens: Camera | None) -> Iterator[tuple[str, FloatArray]]:
    """Yield all targets in a picture but tags, with their places, px, shape (2,)."""
    if board is not None:
        yield from _on_board(grey, board)
    whole: list[Target] = [Cross(), Blob(), *(PlateCorner(which) for which in CORNERS)]
    for target in whole:
        observation = (target if lens is None else target.through(lens)).find(grey)
        if observation is not None:
            yield target.name, observation.pixel


def _on_board(grey: Grey, board: Board) -> Iterator[tuple[str, FloatArray]]:
    for i, at in enumerate(board_corners(grey, board)):
        if np.isfinite(at).all():
            row, column = divmod(i, board.columns)
            own = i == board.target_index
            yield "board" if own else f"corner:{column},{row}", at


def _tags(grey: Grey, place: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield the tags about a place by the smallest set that has them: sets of one size begin alike.

    All sets are tried, so that only a part of the picture is looked at.
    """
    half = TAGS_SHARE * grey.shape[1]
    left, top = np.maximum(place - half, 0).astype(int)
    right, bottom = np.maximum(place + half, 0).astype(int)
    part = np.ascontiguousarray(grey[top:bottom, left:right])
    known: set[tuple[float, ...]] = set()
    for dictionary in DICTIONARIES if part.size else ():
        number = getattr(cv2.aruco, dictionary)
        finder = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(number))
        quads, ids, _ = finder.detectMarkers(part)
        for quad, i in zip(quads, np.ravel([] if ids is None else ids), strict=True):
            centre = quad.reshape(4, 2).mean(axis=0).astype(np.float64) + np.array([left, top])
            at = tuple(centre.round().tolist())
            if at not in known:
                known.add(at)
                yield f"tag:{dictionary}:{int(i)}", centre
