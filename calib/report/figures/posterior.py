"""The joint posterior of a model's parameters."""

from __future__ import annotations

import corner
import numpy as np
from matplotlib.axis import Axis
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from calib.core.arrays import FloatArray
from calib.core.unit_diagonal import unit_diagonal
from calib.fit.posterior import Posterior
from calib.report.numbers import factor, plain_symbol, plus_minus, unit
from calib.report.plotting import (
    BLACK,
    Drawing,
    empty_figure,
    in_house_style,
    plot_style,
    thinned,
)

DRAWS = 16_000
"""Draws of the histograms at most: more change no pixel."""

DRAWN = 0.997
"""Share of the draws that each axis spans: a few far out would shrink all the others."""

LEVELS = (0.393, 0.865)
"""Mass within one and two standard deviations of a normal density in two dimensions."""


@in_house_style
def draw_corner(posterior: Posterior) -> Drawing:
    """Draw all one- and two-dimensional marginals, with the quantiles of the results."""
    names = posterior.names
    scale = np.array([factor(name) for name in names])
    draws = posterior.flat[thinned(len(posterior.flat), DRAWS)] * scale
    labels = [_label(name) for name in names]
    size = min(1.1 + 1.25 * len(names), 8.6)
    figure = empty_figure(height_in=size, width_in=size)
    corner.corner(
        draws,
        fig=figure,
        range=_ranges(draws),
        labels=labels,
        bins=32,
        smooth=1.2,
        levels=LEVELS,
        color=plot_style(posterior.model).colour,
        plot_datapoints=False,
        fill_contours=True,
        max_n_ticks=3,
        label_kwargs={"fontsize": 8},
        hist_kwargs={"lw": 1.2},
    )
    panels = np.array(figure.axes).reshape(len(names), len(names))
    for i, quantiles in enumerate(posterior.quantiles * scale[:, None]):
        for q, style in zip(quantiles, (":", "-", ":"), strict=True):
            panels[i, i].axvline(q, color=BLACK, lw=0.9, ls=style)
    for axes in figure.axes:
        axes.grid(visible=False)
        axes.tick_params(labelsize=7)
    for k in range(len(names)):
        _ticks(panels[-1, k].xaxis)
        if k:
            _ticks(panels[k, 0].yaxis)
    told = "; ".join(
        f"{name} {plus_minus(value, u, factor=factor(name))} {unit(name)}".rstrip()
        for name, value, u in zip(
            names, posterior.mean, np.sqrt(np.diag(posterior.covariance)), strict=True
        )
    )
    correlation, pair = _strongest(posterior)
    return Drawing(
        figure,
        f"Marginal densities of the posterior of {posterior.model}: {told}. Strongest "
        f"correlation: {correlation:+.3f}, of {pair[0]} and {pair[1]}.",
        dict(zip(names, posterior.flat[thinned(len(posterior.flat), DATA_DRAWS)].T, strict=True)),
    )


def _ranges(draws: FloatArray) -> list[tuple[float, float]]:
    """Return the ends of each axis, for draws of shape (m, names)."""
    tails = (1 - DRAWN) / 2
    low, high = np.quantile(draws, [tails, 1 - tails], axis=0)
    # A chain that never moved has no width: its gate has failed, and its figure may show it.
    high = np.maximum(high, low + 1e-9 * np.maximum(np.abs(low), 1.0))
    return list(zip(low.tolist(), high.tolist(), strict=True))


def _ticks(axis: Axis) -> None:
    """Write whole numbers at the ticks, no difference from one that stands elsewhere."""
    axis.set_major_locator(MaxNLocator(3, prune="lower"))
    axis.set_major_formatter(ScalarFormatter(useOffset=False))


DATA_DRAWS = 1000
"""Draws in the data file; `results.h5` has all."""


def _label(name: str) -> str:
    printed = unit(name)
    return f"{plain_symbol(name)} / {printed}" if printed else plain_symbol(name)


def _strongest(posterior: Posterior) -> tuple[float, tuple[str, str]]:
    """Return the correlation farthest from 0 and the two parameters it ties."""
    correlation = unit_diagonal(posterior.covariance)[1] - np.eye(len(posterior.names))
    i, j = np.unravel_index(np.argmax(np.abs(correlation)), correlation.shape)
    return float(correlation[i, j]), (posterior.names[i], posterior.names[j])
