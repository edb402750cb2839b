"""From options to the contents of a dataset."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.core.errors import UsageError
from calib.dataset.lens_section import camera_section
from calib.geometry.board import Board
from calib.geometry.camera import project
from calib.geometry.mirror import SIGN
from calib.geometry.parameters import INDEX, MODELS, NAMES
from calib.geometry.plane import OutOfGazeError
from calib.simulate.contents import (
    Contents,
    CsvTable,
    SimulatedSession,
    SimulationOptions,
    degrees,
    finish,
    ids,
)
from calib.simulate.faults import Context, check_faults, spoil
from calib.simulate.rig import (
    NARROWEST_FIELD_DEG,
    WIDEST_FIELD_DEG,
    TrueRig,
    draw_rig,
    draw_wide_camera,
    mirror_rig,
)
from calib.simulate.scene import fitting_board
from calib.simulate.session import draw_image_session
from calib.simulate.tables import SimulatedRows, draw_targets, no_rig, observe

WIDE_SEED = 15
"""Sets the draw of a wide lens apart from all else, which stays as it is without."""


def plan_dataset(options: SimulationOptions) -> Contents:
    """Return the contents of the dataset that the options describe.

    Raises
    ------
    UsageError
        If the options make no dataset: an unknown model or parameter, no rows, places that no
        camera sees.
    """
    _check(options)
    rigs, rows, lengths = np.random.default_rng(options.seed).spawn(3)
    rig = draw_rig(
        rigs,
        model=options.model,
        fixed=_on_the_right(options),
        image_size=options.image_size,
        noise=options.noise,
    )
    if options.c1_field_deg is not None:
        lens = np.random.default_rng([options.seed, WIDE_SEED])
        c1 = draw_wide_camera(lens, field_deg=options.c1_field_deg, image_size=options.image_size)
        rig = replace(rig, c1=c1)
    if options.is_left:
        rig = mirror_rig(rig)
    near, _ = options.depth_range_mm or rig.depth_range_mm
    board = options.board or fitting_board(rig, near_mm=near)
    draw = draw_image_session if options.images else _draw_table_session
    try:
        return finish(options, draw(options, rig, board, rows), lengths)
    except OutOfGazeError as error:
        raise no_rig(error) from error


def _check_field(options: SimulationOptions) -> None:
    field = options.c1_field_deg
    if field is None:
        return
    if not options.images:
        raise UsageError("--c1-field is of C1's pictures; add --images")
    if not NARROWEST_FIELD_DEG <= field <= WIDEST_FIELD_DEG:
        raise UsageError(
            f"--c1-field {field:g}: an equidistant lens of {NARROWEST_FIELD_DEG:g} to "
            f"{WIDEST_FIELD_DEG:g} degrees along the diagonal can be drawn"
        )


def _check(options: SimulationOptions) -> None:
    if options.model not in MODELS:
        raise UsageError(f"unknown model {options.model!r}; the models are {', '.join(MODELS)}")
    _check_fixed(options)
    check_faults(options.faults)
    if options.faults and options.images:
        raise UsageError("--fault makes mistakes in tables; leave out --images")
    _check_field(options)
    if not 0 <= options.outlier_share <= 1:
        raise UsageError(f"a share of outliers of {options.outlier_share:g} is not between 0 and 1")
    if options.depth_range_mm is not None:
        near, far = options.depth_range_mm
        if not 0 < near < far:
            raise UsageError(f"depths from {near:g} to {far:g} mm are no range; give near, far")
    for count, least, what in _counts(options):
        if count < least:
            raise UsageError(f"{count} {what}; ask for {least} at least")


def _on_the_right(options: SimulationOptions) -> Mapping[str, float]:
    """Return the fixed parameters as they are of the rig that is drawn, with C2 on the right."""
    if not options.is_left:
        return options.fixed
    return {name: float(SIGN[INDEX[name]]) * value for name, value in options.fixed.items()}


def _check_fixed(options: SimulationOptions) -> None:
    fixed, is_left = options.fixed, options.is_left
    unknown = [name for name in fixed if name not in NAMES]
    if unknown:
        raise UsageError(f"unknown parameter {unknown[0]!r}; they are {', '.join(NAMES)}")
    for name, value in fixed.items():
        if not math.isfinite(value):
            raise UsageError(f"{name} = {value:g} is not finite; give a number")
    baseline = fixed.get("baseline_mm", -1.0 if is_left else 1.0)
    if not (baseline < 0 if is_left else baseline > 0):
        stands, wanted, other = ("-X", "below", "right") if is_left else ("+X", "above", "left")
        raise UsageError(
            f"baseline_mm = {baseline:g}: C2 stands at {stands} of C1; give it {wanted} 0, or say "
            f"--c2 {other}"
        )


def _counts(options: SimulationOptions) -> tuple[tuple[int, int, str], ...]:
    """Return every count asked for, the least that makes sense and its name."""
    return (
        (options.rows, 1, "gaze rows"),
        (options.validation_rows, 0, "validation rows"),
        (options.views.count, 1, "intrinsic views a camera"),
        (options.sweep.placements, 0, "placements of the yaw sweep"),
        (options.sweep.images, 2, "images a placement of the yaw sweep"),
    )


def _draw_table_session(
    options: SimulationOptions, rig: TrueRig, board: Board, rng: np.random.Generator
) -> SimulatedSession:
    """Draw a session that hands over finished coordinates."""
    gazes, checks = rng.spawn(2)
    depths = options.depth_range_mm or rig.depth_range_mm
    measured = options.residual_measured
    gaze = observe(
        rig,
        gazes,
        draw_targets(rig, gazes, count=options.rows, depth_range_mm=depths),
        residual_measured=measured,
        outlier_share=options.outlier_share,
    )
    context = Context(rig.resolution_rad, rng)
    gaze = replace(gaze, observed=spoil(gaze.observed, options.faults, context))
    validation = observe(
        rig,
        checks,
        draw_targets(rig, checks, count=options.validation_rows, depth_range_mm=depths),
        residual_measured=measured,
    )
    checked = spoil(validation.observed, options.faults, context, validation=True)
    validation = replace(validation, observed=checked)
    manifest = {
        "gaze": {
            "table": "gaze.csv",
            "reference": "simulated",
            "z_from": "c1",
            "u_x1c": rig.noise.pixel_px / float(rig.c1.matrix[0, 0]),
            "u_z_mm": rig.noise.z_mm,
            "u_z_rel": rig.noise.z_rel,
        },
        "validation": {"table": "validation.csv", "reference": "simulated"},
    }
    if measured:
        exact = {"u_focal": 0.0, "u_centre_px": 0.0}
        manifest["cameras"] = {"c2": camera_section(rig.c2) | exact}
    tables = {
        "gaze.csv": _table(rig, "g", gaze, residual_measured=measured),
        "validation.csv": _table(rig, "v", validation, residual_measured=measured),
    }
    return SimulatedSession(rig, board, gaze, validation, manifest, tables)


def _table(rig: TrueRig, letter: str, rows: SimulatedRows, *, residual_measured: bool) -> CsvTable:
    """Return the table of rows given by coordinates."""
    seen = rows.observed
    columns: dict[str, Sequence[str | float]] = {
        "id": ids(letter, len(seen)),
        **({} if seen.groups == seen.ids else {"group": seen.groups}),
        "x1c": seen.x1c.tolist(),
        "y1c": seen.y1c.tolist(),
        "alpha2_deg": degrees(seen.alpha2_rad),
    }
    if residual_measured:
        rays = np.column_stack([np.tan(seen.gaze_residual_rad), rows.rays_c2[:, 1]])
        columns["u2_px"] = project(rig.c2, rays)[:, 0].tolist()
    return CsvTable.of(columns | {"z_mm": seen.z_mm.tolist(), "u_z_mm": seen.std[:, -1].tolist()})
