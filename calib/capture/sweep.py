"""`calib capture sweep`: C2 turned by itself through readings before a board at rest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from calib.capture.description import add_tables, board_tables, encoder_tables, head_tables
from calib.capture.guidance.asked import Role
from calib.capture.guidance.need import Need
from calib.capture.guidance.sweep import SweepGuide
from calib.capture.guided import TIMEOUT_S as FRAME_TIMEOUT_S
from calib.capture.guided import Ended, Guided, Shot, capture_guided, shot_journal
from calib.capture.intrinsics import corners_of, lens_guide
from calib.capture.journal import now
from calib.capture.shutter import COMPLETE, Finder
from calib.capture.stereo import known_lens_of
from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.dataset.lens_section import camera_section
from calib.images.bundle import finite
from calib.rig.clock import NS_PER_S

TABLE: Final = "sweep.csv"
FOLDER: Final = "sweep/c2"
COLUMNS: Final = ("id", "placement", "image_c2", "alpha2_deg")


def capture_sweep(guided: Guided, need: Need, *, settle_s: float) -> Ended:
    """Sweep before boards put up as asked until the axis is known as well as the need asks.

    Parameters
    ----------
    settle_s
        C2 trembles so long after it stands still.

    Raises
    ------
    UsageError
        If C2's lens is not known yet.
    RigError
        If a device does not answer.
    """
    lens = known_lens_of(guided, "c2", need)
    count = 4 + len(lens.camera.distortion)
    covariance = np.zeros((count, count))
    if lens.information is not None:
        known = lens_guide(guided.folder, "c2", guided.board, guided.known.sizes["c2"], need).known
        at = known.problem.at_lens(0)
        covariance = known.covariance()[np.ix_(at, at)] * known.factor(at)
    guide = SweepGuide(
        guided.board,
        lens.camera,
        covariance,
        range_rad=guided.rig.axis.range_rad,
        resolution_rad=math.radians(guided.known.resolution_deg),
        u_alpha2_rad=math.radians(guided.known.u_alpha2_deg),
        need=need,
    )
    _solve(guided, guide)
    guided.rig.axis.move(guide.middle_rad)

    def taken(shots: Mapping[Role, Shot]) -> None:
        rows = guided.folder.rows(TABLE)
        placement = 1 + max((int(row["placement"]) for row in rows), default=0)
        seen = _sweep(guided, guide.readings(shots["c2"].view.corners), placement, settle_s)
        add_tables(guided.folder, _tables(guided))
        guided.folder.note("view", placement=placement, time=now(), **shot_journal(shots))
        _solve(guided, guide)
        guided.announce(f"placement {placement}: {seen} pictures, u {guide.u:.2g} % of depth")
        if not guide.is_done:
            guided.rig.axis.move(guide.middle_rad)

    return capture_guided(guided, guide, ("c2",), taken)


def _sweep(guided: Guided, readings: FloatArray, placement: int, settle_s: float) -> int:
    """Take a picture at each reading, upwards; return in how many the board is seen."""
    folder, finder, count = guided.folder, Finder(guided.board), 0
    for reading in readings:
        standing = guided.rig.axis.move(float(reading), approach=1)
        rest = standing.since_ns + round(settle_s * NS_PER_S)
        frame = guided.rig.c2.after(rest, timeout_s=FRAME_TIMEOUT_S)
        corners = finder.view(frame.pixels).corners
        if float(finite(corners).mean()) < COMPLETE[guided.board.type]:
            continue
        count += 1
        name = folder.next_picture(FOLDER)
        folder.picture(name, frame.pixels)
        cells = {
            "id": f"s{len(folder.rows(TABLE)) + 1:03d}",
            "placement": str(placement),
            "image_c2": name,
            "alpha2_deg": f"{math.degrees(standing.reading_rad):.9f}",
        }
        folder.add_row(TABLE, COLUMNS, cells)
    return count


def _solve(guided: Guided, guide: SweepGuide) -> None:
    """Let the guide know what the rows say; a sweep that fits no axis is told."""
    rows = guided.folder.rows(TABLE)
    if len(rows) < len(COLUMNS):
        return
    corners = corners_of(guided.folder, [row["image_c2"] for row in rows], guided.board)
    readings = np.radians([float(row["alpha2_deg"]) for row in rows])
    try:
        guide.solve(
            np.array(list(corners.values())), readings, tuple(row["placement"] for row in rows)
        )
    except EstimationError as error:
        guided.announce(str(error))
        guide.count += 1


def _tables(guided: Guided) -> dict[str, Any]:
    known, role = guided.known, "c2"
    cameras = {}
    if not guided.folder.pictures(f"intrinsics/{role}") and role in known.lenses:
        cameras[role] = camera_section(known.lenses["c2"])
    return {
        **head_tables(known, guided.folder.root),
        **board_tables(guided.board),
        **({"cameras": cameras} if cameras else {}),
        **encoder_tables(known),
        "sweep": {"table": TABLE},
    }
