"""`calib capture intrinsics`: a camera's own pictures of the board."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from calib.capture.description import add_tables, board_tables, head_tables, read_manifest
from calib.capture.guidance.asked import Role
from calib.capture.guidance.lens import LensGuide
from calib.capture.guidance.need import Need
from calib.capture.guided import Ended, Guided, Shot, capture_guided, shot_journal
from calib.capture.journal import now
from calib.capture.shutter import Finder
from calib.capture.writer import GrowingFolder
from calib.core.arrays import FloatArray
from calib.core.errors import InputError
from calib.geometry.board import Board
from calib.images.bundle import finite
from calib.images.detection.picture import read_grey
from calib.images.mrcal.solves import MIN_CORNERS

STRAIGHT_RAD: Final = math.pi / 2
"""C2 looks straight ahead meanwhile."""


def capture_intrinsics(guided: Guided, role: Role, need: Need) -> Ended:
    """Take pictures of a camera until its lens is known as well as the need asks.

    Raises
    ------
    InputError
        If the dataset has its lens from elsewhere.
    RigError
        If a device does not answer.
    """
    folder = guided.folder
    _refuse_given(folder, role)
    if role == "c2":
        low, high = guided.rig.axis.range_rad
        guided.rig.axis.move(min(max(STRAIGHT_RAD, low), high))
    guide = lens_guide(folder, role, guided.board, guided.known.sizes[role], need)

    def taken(shots: Mapping[Role, Shot]) -> None:
        name = folder.next_picture(f"intrinsics/{role}")
        folder.picture(name, shots[role].frame.pixels)
        add_tables(folder, lens_tables(guided, role))
        folder.note("view", image=name, time=now(), u=guide.u, **shot_journal(shots))
        guided.announce(f"{name}: u {guide.u:.2g} px")

    return capture_guided(guided, guide, (role,), taken)


def lens_guide(
    folder: GrowingFolder, role: Role, board: Board, image_size: tuple[int, int], need: Need
) -> LensGuide:
    """Return the guide of a lens with the pictures that a folder has already."""
    guide = LensGuide(role, board, image_size, needed_rad=need.lens_px(1.0))
    views = corners_of(folder, folder.pictures(f"intrinsics/{role}"), board)
    guide.add(*(view for view in views.values() if _is_usable(view)))
    return guide


def corners_of(folder: GrowingFolder, names: list[str], board: Board) -> dict[str, FloatArray]:
    """Return the corners in pictures, px, shape (corners, 2) each; NaN where not found."""
    finder = Finder(board)
    return {name: finder.view(read_grey(folder.root / name, name=name)).corners for name in names}


def _is_usable(view: FloatArray) -> bool:
    return int(finite(view).sum()) >= MIN_CORNERS


def lens_tables(guided: Guided, role: Role) -> dict[str, Any]:
    """Return what the manifest says of a camera's own pictures."""
    camera = {"image_size": list(guided.known.sizes[role]), "images": f"intrinsics/{role}/*.png"}
    return {
        **head_tables(guided.known, guided.folder.root),
        **board_tables(guided.board),
        "cameras": {role: camera},
    }


def _refuse_given(folder: GrowingFolder, role: Role) -> None:
    manifest = read_manifest(folder)
    section = None if manifest is None else manifest.camera(role)
    if section is not None and section.images is None:
        raise InputError.single(
            where="dataset.toml",
            what=f"[cameras.{role}] has the lens of {role} already, from elsewhere",
            remedy="capture into a new folder, before gaze rows",
        )
