"""The linear and the convex calibration side by side, and what their third unknown says."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from calib.fit.convex import ConvexFit
from calib.fit.linear import LinearFit
from calib.report.blocks import EMPTY, Block, Cell, Chapter, Paragraph, Table, Text, table, words
from calib.report.context import ReportContext
from calib.report.numbers import (
    decimals,
    digits,
    estimate,
    factor,
    plus_minus,
    signed,
    symbol,
    unit,
)
from calib.report.sections.pick import axis_z_mm, instrument_of_record
from calib.results.calibration import Calibration, GazeResult
from calib.uncertainty.format import fixed, significant


def linear(c: Calibration, _: ReportContext) -> Chapter | None:
    """Write the linear and the convex calibration."""
    if c.gaze is None or (c.gaze.linear is None and c.gaze.convex is None):
        return None
    gaze = c.gaze
    blocks: list[Block] = [
        Paragraph(
            Markup(
                "The paper solves its model as linear equations in three unknowns: "
                "<i>L</i><sub>b</sub>, tan <i>δ</i><sub>2</sub> and their product. The convex fit "
                "solves the same equations with every row weighted by its uncertainty, gross "
                "errors held down by Huber's loss, and a proof that no better solution exists."
            )
        ),
        _table(gaze),
    ]
    if gaze.linear is not None:
        blocks.append(Paragraph(_third_unknown(gaze, gaze.linear)))
    return Chapter("linear", "Linear and convex calibration", tuple(blocks))


def _table(gaze: GazeResult) -> Table:
    a, b = gaze.linear, gaze.convex
    rows: list[tuple[Cell, ...]] = [
        (_named("baseline_mm"), _value(a, 0), _value(b, 0)),
        (_named("delta2_rad"), _value(a, 1), _value(b, 1)),
        (
            words("Standard deviation of the residuals / mrad"),
            EMPTY if a is None else digits(a.sigma_mrad),
            EMPTY if b is None else digits(b.sigma_mrad),
        ),
        (
            words("Z of the yaw axis that the third unknown implies / mm"),
            EMPTY if a is None else decimals(a.implied_axis_z_mm, 1),
            EMPTY if b is None else decimals(b.implied_axis_z_mm, 1),
        ),
        (
            words(Markup("Third unknown, <i>L</i><sub>b</sub> tan <i>δ</i><sub>2</sub> / mm")),
            EMPTY if a is None else decimals(a.product_mm, 2),
            EMPTY,
        ),
        (
            words("Its distance from the product of the other two / mm"),
            EMPTY if a is None else decimals(a.inconsistency_mm, 2),
            EMPTY,
        ),
        (
            words("Condition number of the equations"),
            EMPTY if a is None else digits(a.condition, 2),
            EMPTY,
        ),
    ]
    if b is not None:
        rows += _proof(b)
    return table("Both calibrations of the paper's model", ("", "linear", "convex"), rows)


def _named(name: str) -> Cell:
    return words(Markup("{} ± u / {}").format(symbol(name), unit(name)))


def _value(fit: LinearFit | ConvexFit | None, i: int) -> Cell:
    """Return a cell with parameter i, 0 the baseline, 1 the encoder zero."""
    if fit is None:
        return EMPTY
    std = float(np.sqrt(fit.covariance[i, i]))
    return estimate(fit.values[i], std, factor=factor(fit.names[i]))


def _proof(fit: ConvexFit) -> list[tuple[Cell, ...]]:
    optimal = "proved optimal" if fit.optimal else "not proved optimal"
    return [
        (words("Solver's status"), EMPTY, words(fit.status)),
        (
            words("Relative duality gap"),
            EMPTY,
            words(
                f"{signed(significant(fit.duality_gap, digits=2))}, {optimal}",
                mark="good" if fit.optimal else "bad",
            ),
        ),
        (words("Unknowns on a bound"), EMPTY, words(", ".join(fit.at_bound) or "none")),
        (words("Outliers"), EMPTY, words(", ".join(fit.outliers[:20]) or "none")),
    ]


def _third_unknown(gaze: GazeResult, linear: LinearFit) -> Text:
    text = Markup(
        "The third unknown should be the product of the other two; it came out {} mm away from it. "
        "In the exact geometry with <i>e</i> = 0 this distance is no slip of arithmetic: it is "
        "<i>Z</i><sub>a</sub> (1 + tan² <i>δ</i><sub>2</sub>), where the yaw axis stands. It "
        "implies <i>Z</i><sub>a</sub> = {} mm."
    ).format(fixed(linear.inconsistency_mm, 1), signed(fixed(linear.implied_axis_z_mm, 1)))
    found = axis_z_mm(gaze)
    if found is not None:
        text += Markup(" By {} it is {} mm.").format(instrument_of_record(gaze), plus_minus(*found))
    return text
