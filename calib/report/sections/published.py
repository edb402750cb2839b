"""Published values of the same cameras, where the dataset states some."""

from __future__ import annotations

import numpy as np

from calib.report.blocks import EMPTY, Cell, Chapter, Paragraph, number, table, words
from calib.report.context import ReportContext
from calib.report.numbers import estimate
from calib.results.calibration import Calibration
from calib.results.published import image_estimates


def published(c: Calibration, context: ReportContext) -> Chapter | None:
    """Write the comparison with published values."""
    if not context.published:
        return None
    found = image_estimates(c.images)
    rows = [_row(name, known, found.get(name)) for name, known in context.published.items()]
    return Chapter(
        "published",
        "Against published values",
        (
            Paragraph(
                "Values that others have published for these cameras, with their standard "
                "uncertainties, beside those found here. The last column is the difference over "
                "the uncertainty of the difference: beyond 2 the two contradict each other, or one "
                "uncertainty is too small. Both come from the same pictures where the source says "
                "so; the difference should then be well below 1."
            ),
            table(
                "Published and found; C1 in C2 is P2 = R P1 + t",
                ("Quantity", "Published ± u", "Found ± u", "Difference / u"),
                rows,
            ),
        ),
    )


def _row(
    name: str, known: tuple[float, float], here: tuple[float, float] | None
) -> tuple[Cell, ...]:
    value, u = known
    shown = estimate(value, u)
    if here is None:
        return words(name), shown, EMPTY, EMPTY
    score = (here[0] - value) / float(np.hypot(here[1], u))
    mark = "bad" if abs(score) > 2 else ""
    return (
        words(name),
        shown,
        estimate(*here),
        number(f"{score:+.1f}", score, mark=mark),
    )
