"""The stereo reference: the pose of C2 in C1, and the depths that come from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from calib.core.arrays import FloatArray
from calib.geometry.poses import invert_pose
from calib.images.result import ImageResult
from calib.images.stereo.reference import StereoReference
from calib.report.blocks import (
    EMPTY,
    Block,
    Cell,
    Chapter,
    DefinitionList,
    Fold,
    Paragraph,
    Table,
    facts,
    number,
    table,
    words,
)
from calib.report.context import ReportContext
from calib.report.figures.stereo import draw_pairs, draw_targets
from calib.report.numbers import decimals, digits, estimate, plus_minus
from calib.report.plotting import picture
from calib.report.sections.board_pictures import pair_faults, residual_cells
from calib.report.sections.pick import shown_rows
from calib.results.calibration import Calibration


def stereo(c: Calibration, _: ReportContext) -> Chapter | None:
    """Write the stereo reference."""
    reference = c.images.stereo
    if reference is None:
        return None
    blocks: list[Block] = [
        Paragraph(
            "With C2 held at one yaw, pairs of pictures of the board give the pose of C2 in C1, "
            "solved together with both lenses and the shape of the board, "
            "and, by triangulation, the position of the target in each pair: the depths that the "
            "gaze rows are calibrated against."
        ),
        _facts(reference),
        _poses(reference),
    ]
    if reference.solves:
        blocks += [
            _solves(reference),
            picture(
                "stereo-residuals",
                draw_pairs(reference),
                "Residuals of each pair. One pair far above the others was taken in motion, or is "
                "no pair; all high in one camera, its intrinsics are not those of these pictures.",
            ),
            Fold(
                f"All {len(c.images.pairs or reference.stems)} pairs by their pictures",
                (_pairs(reference, c.images),),
            ),
        ]
    if reference.targets.stems:
        blocks += [
            picture(
                "stereo-targets",
                draw_targets(reference),
                "Cross-check: depth from the board's pose in C1 alone less triangulated depth; "
                "bars are 95 % intervals of the difference. A trend with depth is a wrong baseline "
                "or a wrong size of the squares; it would go unnoticed into the calibration.",
            ),
            _targets(reference),
        ]
    return Chapter("stereo", "Stereo reference", tuple(blocks))


_JOINT = "a joint solve with the lenses, from all pictures of the board (validation left out)"


def _facts(s: StereoReference) -> DefinitionList:
    return facts(
        ("Pose by", {"given": "the manifest", "joint": _JOINT}.get(s.source, s.source)),
        ("Distance of the centres", f"{plus_minus(s.baseline_mm, s.baseline_std_mm)} mm"),
        ("Pairs used", str(len(s.stems))),
        ("Boards read from the other end", ", ".join(s.turned)),
    )


def _poses(s: StereoReference) -> Table:
    """Return the pose of record in both directions: papers use either."""
    heads = (
        "",
        Markup("C2 in C1: <i>P</i><sub>1</sub> = R <i>P</i><sub>2</sub> + t"),
        Markup("C1 in C2: <i>P</i><sub>2</sub> = R <i>P</i><sub>1</sub> + t"),
    )
    both = [(s.pose_12, s.covariance), invert_pose(s.pose_12, s.covariance)]
    return table("Pose of the cameras, ± standard uncertainty", heads, _pose_rows(both))


_POSE = ((0, "rotation", 1e3, "mrad"), (3, "t", 1.0, "mm"))
"""Place in a pose, name, factor and unit of its two halves."""


def _pose_rows(poses: Sequence[tuple[FloatArray, FloatArray]]) -> list[list[Cell]]:
    """Return the six rows of poses with their covariances, one pose a column."""
    return [
        [
            words(f"{name} {axis} / {unit}"),
            *(
                estimate(pose[first + k], float(np.sqrt(c[first + k, first + k])), factor=times)
                for pose, c in poses
            ),
        ]
        for first, name, times, unit in _POSE
        for k, axis in enumerate("xyz")
    ]


def _solves(s: StereoReference) -> Table:
    names = [f"{solve.backend}, intrinsics {solve.intrinsics}" for solve in s.solves]
    rows = _pose_rows([(solve.pose_12, solve.covariance) for solve in s.solves])
    rows += [
        [words("rms / px"), *(decimals(solve.rms_px, 3) for solve in s.solves)],
        [words("Corners rejected"), *(number(str(v.rejected), v.rejected) for v in s.solves)],
        [words("u multiplied by the factor"), *(digits(v.dispersion**0.5) for v in s.solves)],
    ]
    heads = ["", f"{names[0]} (used)", *names[1:]]
    return table(
        "Pose of C2 in C1 by each backend, ± standard uncertainty",
        heads,
        rows,
        note="Free: lenses solved together with the pose, from all their pictures. Held, joint: "
        "lenses as their own pictures gave them; held, OpenCV: as used, the board flat. The factor "
        "is how far the pairs disagree with each other, over what the noise of their corners "
        "explains.",
    )


def _pairs(s: StereoReference, images: ImageResult) -> Table:
    """Return each pair by its pictures with its residuals by the solve of record."""
    place = {stem: i for i, stem in enumerate(s.stems)}
    residuals, faults, rows = s.solves[0].residuals, pair_faults(images), []
    for stem, names in (images.pairs or {stem: (stem, stem) for stem in s.stems}).items():
        i = place.get(stem)
        both = [None if i is None else residuals[which, i] for which in (0, 1)]
        rows.append(
            (
                *map(words, names),
                *(cell for one in both for cell in residual_cells(one)),
                words("yes") if i is not None else words(faults[stem], mark="bad"),
            )
        )
    heads: tuple[str, ...] = ("Picture of C1", "Picture of C2")
    heads += tuple(
        f"{camera}: {what}"
        for camera in ("C1", "C2")
        for what in ("corners kept", "rms / px", "largest / px")
    )
    return table(
        "Pairs",
        (*heads, "Used"),
        rows,
        note='A pair is left out by exclude = ["..."] in [stereo], by the name of either picture.',
        sortable=True,
        dense=True,
    )


def _targets(s: StereoReference) -> Table:
    t = s.targets
    picked, note = shown_rows(len(t.stems))
    rows = []
    for i in picked:
        x, y, z = t.triangulated.position_mm[i]
        known = np.isfinite(t.board_sigmas[i])
        rows.append(
            (
                words(t.stems[i]),
                decimals(x, 1),
                decimals(y, 1),
                estimate(z, float(t.depth_std_mm[i])),
                decimals(t.by_board.position_mm[i, 2], 1),
                decimals(t.board_sigmas[i], 1) if known else EMPTY,
                decimals(t.triangulated.miss_px[i], 3),
            )
        )
    heads = (
        "Pair",
        "x / mm",
        "y / mm",
        "z ± u / mm",
        "z by board / mm",
        "difference / standard deviations",
        "rays miss each other by / px",
    )
    return table("Targets of the pairs, in C1", heads, rows, note=note, sortable=True)
