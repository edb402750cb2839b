"""A rig's control charts as one figure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from calib.history.charts import charts, reference
from calib.history.quantities import Series
from calib.report.plotting import BLUE, GREY, VERMILLION, in_house_style, new_figure

_PANEL_IN = 1.35


@in_house_style
def chart_figure(found: Sequence[Series], *, accepted: int) -> Figure:
    """Return the charts, a row a quantity, a column a chart, alarms in red and square.

    Statistics are those of what came after acceptance, over their dates.
    """
    figure = new_figure(height_in=_PANEL_IN * len(found) + 0.9, width_in=10.0)
    figure.subplots_adjust(hspace=0.55)
    axes = figure.subplots(len(found), 3, squeeze=False, sharex=True)
    for row, one in zip(axes, found, strict=True):
        _row(row, one, accepted)
    for bottom in axes[-1]:
        bottom.xaxis_date()
    figure.autofmt_xdate()
    return figure


def _row(row: np.ndarray, one: Series, accepted: int) -> None:
    after = slice(accepted, None)
    at = reference(one.values[:accepted], one.std[:accepted])
    when = np.array([np.datetime64(text) for text in one.dates[after]])
    for axes, chart in zip(row, charts(one.values[after], one.std[after], at), strict=True):
        out = np.abs(chart.statistic) > chart.limit
        axes.plot(when, chart.statistic, color=BLUE, marker="o", markersize=3.0)
        axes.plot(when[out], chart.statistic[out], color=VERMILLION, marker="s", linestyle="none")
        for limit in (-chart.limit, chart.limit):
            axes.axhline(limit, color=GREY, linestyle="--", linewidth=1.0)
        axes.axhline(0, color=GREY, linewidth=0.7)
        farthest = float(np.max(np.abs(chart.statistic), initial=chart.limit))
        axes.set_ylim(-1.15 * farthest, 1.15 * farthest)
        axes.set_title(f"{one.name}: {chart.name}")
