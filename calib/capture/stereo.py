"""`calib capture stereo`: pictures of one board by both cameras, C2 held at one reading."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any, Final

import numpy as np

from calib.capture.description import add_tables, board_tables, head_tables, read_manifest
from calib.capture.guidance.asked import Role
from calib.capture.guidance.need import Need
from calib.capture.guidance.pairs import (
    LensSays,
    PairGuide,
    by_tape,
    holding_reading,
    lens_says,
)
from calib.capture.guided import Ended, Guided, Shot, capture_guided, shot_journal
from calib.capture.intrinsics import corners_of, lens_guide
from calib.capture.journal import now
from calib.core.errors import InputError, UsageError
from calib.dataset.lens_section import camera_section, stated_camera
from calib.images.intrinsics.calibrate import MIN_VIEWS
from calib.rig.protocols import Standstill

FOLDERS: Final[Mapping[Role, str]] = {"c1": "stereo/c1", "c2": "stereo/c2"}

SAME_DEG: Final = 1e-6
"""Readings are written to so many decimals."""


def capture_stereo(guided: Guided, need: Need) -> Ended:
    """Take pairs until depths by them are known as well as the need asks.

    C2 goes to the reading of the pairs that are there, or looks at the middle of the depths.

    Raises
    ------
    UsageError, InputError
        If a lens is not known yet, or C2 does not come back to where it stood.
    RigError
        If a device does not answer.
    """
    folder = guided.folder
    lenses = known_lens_of(guided, "c1", need), known_lens_of(guided, "c2", need)
    standing = _stand(guided, need)
    baseline = need.baseline_mm * (-1 if guided.known.is_left else 1)
    tape = by_tape(baseline, standing.reading_rad)
    guide = PairGuide(guided.board, lenses, tape, need)
    guide.add(*_pairs(guided))

    def taken(shots: Mapping[Role, Shot]) -> None:
        name = PurePosixPath(folder.next_picture(FOLDERS["c2"])).name
        # C1's first: a picture without its fellow is written over by the next pair.
        for role in ("c1", "c2"):
            folder.picture(f"{FOLDERS[role]}/{name}", shots[role].frame.pixels)
        add_tables(folder, _tables(guided, lenses, math.degrees(standing.reading_rad)))
        folder.note("view", image=name, time=now(), u=guide.u, **shot_journal(shots))
        guided.announce(f"pair {name}: u {guide.u:.2g} %")

    return capture_guided(guided, guide, ("c1", "c2"), taken)


def known_lens_of(guided: Guided, role: Role, need: Need) -> LensSays:
    """Return a lens as its own pictures tell, or as it is given.

    Raises
    ------
    UsageError
        If it is not known.
    """
    guide = lens_guide(guided.folder, role, guided.board, guided.known.sizes[role], need)
    if guide.count >= MIN_VIEWS:
        return lens_says(guide.known)
    manifest = read_manifest(guided.folder)
    section = None if manifest is None else manifest.camera(role)
    given = stated_camera(section, guided.known.sizes[role])
    if given is not None:
        return LensSays(given, None)
    if section is None and role in guided.known.lenses and not guide.count:
        return LensSays(guided.known.lenses[role], None)
    raise UsageError(
        f"the lens of {role} is not known: {guide.count} pictures of its own, {MIN_VIEWS} are "
        "needed; run `calib capture intrinsics` first"
    )


def _stand(guided: Guided, need: Need) -> Standstill:
    """Turn C2 to the reading of the pairs and return how it stands there."""
    manifest = read_manifest(guided.folder)
    stated = None if manifest is None or manifest.stereo is None else manifest.stereo.alpha2_deg
    if stated is None:
        baseline = need.baseline_mm * (-1 if guided.known.is_left else 1)
        return guided.rig.axis.move(holding_reading(need, baseline))
    standing = guided.rig.axis.move(math.radians(stated))
    off = abs(math.degrees(standing.reading_rad) - stated)
    if off > guided.known.resolution_deg + SAME_DEG:
        raise InputError.single(
            where="dataset.toml",
            what=f"[stereo] was taken at {stated:.6f} deg, C2 came to rest {off:.6f} deg beside it",
            remedy="capture the pairs into a new folder",
        )
    return standing


def _pairs(guided: Guided) -> list[Any]:
    """Return the corners of the pairs that are there, (2, corners, 2) each."""
    names = [PurePosixPath(name).name for name in guided.folder.pictures(FOLDERS["c2"])]
    both = [
        corners_of(guided.folder, [f"{FOLDERS[role]}/{name}" for name in names], guided.board)
        for role in ("c1", "c2")
    ]
    pairs = [np.stack(pair) for pair in zip(*(found.values() for found in both), strict=True)]
    return [pair for pair in pairs if np.isfinite(pair).all(axis=-1).sum(axis=-1).min() > 8]


def _tables(
    guided: Guided, lenses: tuple[LensSays, LensSays], reading_deg: float
) -> dict[str, Any]:
    cameras = {
        role: camera_section(lens.camera)
        for role, lens in zip(("c1", "c2"), lenses, strict=True)
        if lens.information is None
    }
    section = {role: f"{under}/*.png" for role, under in FOLDERS.items()}
    return {
        **head_tables(guided.known, guided.folder.root),
        **board_tables(guided.board),
        "cameras": cameras,
        "stereo": {**section, "alpha2_deg": round(reading_deg, 9)},
    }
