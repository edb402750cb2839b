"""What the models leave of the rows, and what that says of the rig."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from calib.geometry.plane import OBSERVABLE
from calib.report.blocks import EMPTY, Block, Cell, Chapter, Paragraph, Table, Text, table, words
from calib.report.context import ReportContext
from calib.report.figures.residuals import (
    draw_residuals_against,
    draw_residuals_by_row,
    draw_scatter,
)
from calib.report.numbers import decimals, digits, plus_minus
from calib.report.plotting import picture
from calib.report.sections.pick import (
    AXIS_Z,
    axis_z_mm,
    chosen_fit,
    contrasted,
    instrument_of_record,
    reading_mrad,
)
from calib.results.calibration import Calibration, GazeResult
from calib.uncertainty.format import significant


def residuals(c: Calibration, context: ReportContext) -> Chapter | None:
    """Write the residuals before and after."""
    if c.gaze is None or not c.gaze.robust:
        return None
    gaze, fits = c.gaze, contrasted(c.gaze)
    step = None if context.encoder_step_rad is None else 1e3 * context.encoder_step_rad / 12**0.5
    reading = reading_mrad(gaze)
    blocks: list[Block] = [
        Paragraph(_finding(gaze, step, reading)),
        picture(
            "scatter",
            draw_scatter(_scatter(gaze), step_mrad=step, reading_mrad=reading),
            "Standard deviation of the residuals that each fit leaves. What lies well to the right "
            "of the lines is not the encoder: something of the rig is missing from that model, or "
            "rows are wrong. What lies well to their left is fitted too closely, or was stated too "
            "cautiously.",
        ),
        _table(gaze),
        picture(
            "residuals-by-row",
            draw_residuals_by_row(gaze.rows, fits),
            Markup(
                "Residual (<i>L</i><sub>b</sub> + <i>Z</i><sub>a</sub> cot <i>α</i> + <i>e</i> / "
                "sin <i>α</i>) / <i>z</i> − (x1c + cot <i>α</i>) of each row, an angle. One row "
                "far off, ringed where it counts as an outlier, is a misread angle or a mistaken "
                "target; residuals that follow each other from row to row are a rig that moved."
            ),
        ),
        picture(
            "residuals-against",
            draw_residuals_against(gaze.rows, fits),
            "The same residuals against reference depth and against the direction in C1. They "
            "should scatter about zero. A trend with depth is a wrong baseline or reference; a "
            "trend with x1c is an offset yaw axis, an encoder scale or a lens error.",
        ),
    ]
    return Chapter("residuals", "Residuals before and after", tuple(blocks))


def _finding(gaze: GazeResult, step: float | None, reading: float) -> Text:
    """Return what the residuals say, in a few sentences."""
    chosen, base = chosen_fit(gaze), gaze.robust.get("base")
    encoder = _encoder(gaze, step, reading)
    if chosen is None or base is None or chosen.model == "base":
        left = "; ".join(
            f"{name} leaves {significant(fit.sigma_mrad, digits=2)} mrad"
            for name, fit in gaze.robust.items()
        )
        return Markup("{}. {}").format(left[:1].upper() + left[1:], encoder)
    return Markup(
        "The paper's model, <em>base</em>, leaves residuals of <strong>{} mrad</strong>; "
        "<em>{}</em> leaves <strong>{} mrad</strong>. {} Against all stated uncertainties of a row "
        "together, the residuals of <em>base</em> are {} times as large as expected, those of "
        "<em>{}</em> {} times.{}"
    ).format(
        significant(base.sigma_mrad, digits=2),
        chosen.model,
        significant(chosen.sigma_mrad, digits=2),
        encoder,
        significant(base.noise_scale, digits=2),
        chosen.model,
        significant(chosen.noise_scale, digits=2),
        _axis(gaze),
    )


def _encoder(gaze: GazeResult, step: float | None, reading: float) -> str:
    """Return how much of the residuals the gaze angle accounts for."""
    told = significant(reading, digits=2)
    alone = "" if step is None else significant(step, digits=2)
    if np.all(gaze.rows.std[:, OBSERVABLE.residual] > 0):
        return (
            f"The gaze angle, whose last digit C2's pictures give, accounts for {told} mrad; the "
            f"encoder's step alone would for {alone} mrad."
        )
    step_part = f", its step alone for {alone} mrad" if alone else ""
    return f"The encoder's reading as stated accounts for {told} mrad{step_part}."


def _axis(gaze: GazeResult) -> Text:
    """Return where the yaw axis stands, as certified, if the data decided it."""
    fit, found = chosen_fit(gaze), axis_z_mm(gaze)
    if fit is None or found is None or AXIS_Z not in fit.names:
        return ""
    if fit.identified_by[fit.names.index(AXIS_Z)] == "prior":
        return ""
    value, u = found
    side = "behind" if value < 0 else "in front of"
    return Markup(
        " Where <em>base</em> takes the yaw axis to stand level with C1, {} finds it {} mm "
        "{} C1's optical centre (<i>Z</i><sub>a</sub> = {} mm)."
    ).format(
        instrument_of_record(gaze), significant(abs(value), digits=2), side, plus_minus(value, u)
    )


def _scatter(gaze: GazeResult) -> dict[str, float]:
    found = {}
    if gaze.linear is not None:
        found["base/linear"] = gaze.linear.sigma_mrad
    if gaze.convex is not None:
        found["base/convex"] = gaze.convex.sigma_mrad
    return found | {f"{name}/robust": fit.sigma_mrad for name, fit in gaze.robust.items()}


def _table(gaze: GazeResult) -> Table:
    rows: list[tuple[Cell, ...]] = []
    if gaze.linear is not None:
        rows.append(
            (words("base/linear"), digits(gaze.linear.sigma_mrad), *[EMPTY] * 2, words("–"))
        )
    if gaze.convex is not None:
        named = _named(gaze.convex.outliers)
        rows.append((words("base/convex"), digits(gaze.convex.sigma_mrad), *[EMPTY] * 2, named))
    for name, fit in gaze.robust.items():
        rows.append(
            (
                words(f"{name}/robust"),
                digits(fit.sigma_mrad),
                digits(fit.noise_scale),
                decimals(fit.data_parameters, 1),
                _named(fit.outliers),
            )
        )
    heads = (
        "Fit",
        "Standard deviation / mrad",
        "Noise scale",
        "Parameters identified by the data",
        "Outliers",
    )
    note = (
        "The noise scale is the factor between the residuals and the stated uncertainties of x1c, "
        "α2 and z together."
    )
    return table("What each fit leaves", heads, rows, note=note)


def _named(outliers: tuple[str, ...]) -> Cell:
    more = f" and {len(outliers) - 10} more" if len(outliers) > 10 else ""
    return words(", ".join(outliers[:10]) + more if outliers else "none")
