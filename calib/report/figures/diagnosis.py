"""Residuals without and with a diagnosed cause."""

from __future__ import annotations

import numpy as np

from calib.diagnosis.findings import Cause
from calib.report.plotting import (
    BLACK,
    Drawing,
    cloud,
    in_house_style,
    label_rows,
    legend,
    new_figure,
    plot_style,
)

BEFORE, AFTER, BOTH = "base", "axis-offset", "encoder"
"""Styles of the residuals."""


@in_house_style
def draw_cause(cause: Cause, second: Cause | None = None) -> Drawing:
    """Draw the residual of each row without the cause and with it as a parameter.

    Parameters
    ----------
    second
        A cause beside it; its rows are among those of the first, or are not drawn.
    """
    figure = new_figure(height_in=3.0)
    axes = figure.subplots()
    before, after = cause.residual_mrad
    place = {name: float(i) for i, name in enumerate(cause.ids)}
    everywhere = np.arange(len(place), dtype=float)
    cloud(axes, everywhere, before, plot_style(BEFORE), label="model alone")
    cloud(axes, everywhere, after, plot_style(AFTER), label=f"with {cause.name}")
    left, data = f"{_rms(after):.2g} mrad with {cause.name}", {}
    if second is not None:
        both = np.full(len(place), np.nan)
        for name, residual in zip(second.ids, second.residual_mrad[1], strict=True):
            if name in place:
                both[int(place[name])] = residual
        cloud(axes, everywhere, both, plot_style(BOTH), label=f"and {second.name}")
        left += f", {_rms(both[np.isfinite(both)]):.2g} mrad with {second.name} beside it"
        data = {"both_mrad": both}
    axes.axhline(0, color=BLACK, lw=0.8)
    label_rows(axes, cause.ids, what="row")
    axes.set_ylabel("residual / mrad")
    legend(figure, axes)
    return Drawing(
        figure,
        f"Residuals of {len(cause.ids)} rows: root mean square {_rms(before):.2g} mrad by the "
        f"model alone, {left}.",
        {"id": cause.ids, "before_mrad": before, "after_mrad": after, **data},
    )


def _rms(residual: np.ndarray) -> float:
    return float(np.sqrt(np.mean(residual**2)))
