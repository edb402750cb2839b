"""The yaw sweep: where the yaw axis stands in C2's frame."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from calib.images.sweep.yaw_axis import SweepResult
from calib.report.blocks import (
    Block,
    Chapter,
    DefinitionList,
    Fold,
    Paragraph,
    Table,
    facts,
    table,
    words,
)
from calib.report.context import ReportContext
from calib.report.figures.sweep import draw_axis, draw_sweep
from calib.report.numbers import (
    decimals,
    estimate,
    factor,
    meaning,
    plus_minus,
    signed,
    symbol,
    unit,
)
from calib.report.plotting import picture
from calib.report.sections.board_pictures import residual_cells
from calib.results.calibration import Calibration
from calib.uncertainty.format import fixed


def sweep(c: Calibration, _: ReportContext) -> Chapter | None:
    """Write the yaw sweep."""
    found = c.images.sweep
    if found is None:
        return None
    blocks: list[Block] = [
        Paragraph(
            Markup(
                "C2 was turned through known angles before a board at rest. From the pictures "
                "follow the yaw axis in C2's frame and with it the distance <i>e</i> of the gaze "
                "plane from the axis, which gaze rows near 90° cannot distinguish from "
                "<i>L</i><sub>b</sub>. What was measured here enters the extended models."
            )
        ),
        _measured(found),
        _facts(found),
        picture(
            "sweep",
            draw_sweep(found),
            "Residual of each picture and error of each reading, against the reading. Errors that "
            "run in a wave are an off-centre encoder disc; a slope, a wrong number of steps; one "
            "reading far off, a lost step. Residuals that grow to one side are a board that moved.",
        ),
        picture(
            "axis",
            draw_axis(found),
            "The yaw axis from above, in C2's frame. A region much longer than the distance itself "
            "means that the sweep was too narrow, or the board too far, to tell where the axis is.",
        ),
        Fold(f"All {len(found.images)} pictures of the sweep by name", (_pictures(found),)),
    ]
    return Chapter("sweep", "Yaw sweep", tuple(blocks))


def _measured(s: SweepResult) -> Table:
    std = np.sqrt(np.diag(s.covariance))
    rows = [
        (
            words(symbol(name)),
            words(meaning(name)),
            estimate(value, float(u), factor=factor(name)),
            words(unit(name)),
        )
        for name, value, u in zip(s.names, s.mean, std, strict=True)
    ]
    return table("What the sweep measures", ("Symbol", "Meaning", "Estimate ± u", "Unit"), rows)


def _pictures(s: SweepResult) -> Table:
    """Return each picture by name with its residuals and the error of its reading."""
    rows = [
        (
            words(name),
            decimals(float(np.rad2deg(reading)), 3),
            *residual_cells(residuals),
            decimals(float(np.rad2deg(error)), 4),
        )
        for name, reading, residuals, error in zip(
            s.images, s.readings_rad, s.residuals, s.reading_errors_rad, strict=True
        )
    ]
    heads = (
        "Picture",
        Markup("<i>α</i><sub>2</sub> / °"),
        "corners kept",
        "rms / px",
        "largest residual / px",
        "error of the reading / °",
    )
    return table(
        "Pictures of the sweep",
        heads,
        rows,
        note='A picture is left out by exclude = ["..."] in [sweep], by the name given here.',
        sortable=True,
    )


def _facts(s: SweepResult) -> DefinitionList:
    direction = ", ".join(signed(fixed(float(d), 5)) for d in s.axis_direction_c2)
    foot = ", ".join(decimals(float(f), 2).text for f in s.axis_foot_c2_mm)
    low, high = np.rad2deg([s.readings_rad.min(), s.readings_rad.max()])
    return facts(
        ("Pictures", f"{len(s.images)}, in {len(s.placements)} placements of the board"),
        ("Readings", f"{low:.1f}° to {high:.1f}°"),
        ("Direction of the axis in C2", direction),
        ("Foot of the axis in C2", f"{foot} mm"),
        ("Roll of C2", f"{plus_minus(s.gaze_roll_rad, s.gaze_roll_std_rad, factor=1e3)} mrad"),
        ("Scale error of the encoder", plus_minus(s.encoder_scale, s.encoder_scale_std)),
        ("rms residual", f"{fixed(s.rms_px, 3)} px; {s.rejected} corners rejected"),
    )
