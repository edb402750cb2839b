"""Figures of a study: one function each, scores in, matplotlib figure out."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.geometry.parameters import INDEX, PARAMETERS
from calib.study.conditions import GROUPS
from calib.study.scores import LEVELS, StudyScore

INK, MUTED, BLUE, RED, GREEN = "#1b1b1b", "#6b6b6b", "#0072B2", "#D55E00", "#009E73"
WIDTH_INCH, ROW_INCH = 7.0, 0.24

_STYLE: Any = {
    "font.size": 8.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": MUTED,
    "legend.frameon": False,
    "svg.hashsalt": "calib",
    "svg.fonttype": "path",
}


ESTIMATORS = {
    "linear": ("linear equations of the paper", MUTED),
    "bilinear": ("weighted least squares, outliers kept", RED),
    "robust": ("robust fit", BLUE),
    "posterior": ("posterior mean", GREEN),
}
"""Estimators by their keys in the table, as a figure names and paints them."""


def _name(subject: str) -> str:
    """Return the symbol of a parameter, in matplotlib's mathematics; else the words themselves."""
    if subject not in INDEX:
        return "noise scale" if subject == "noise_scale" else subject
    stem, _, index = PARAMETERS[INDEX[subject]].symbol.partition("_")
    if not index and stem[-1].isdigit():
        stem, index = stem[:-1], stem[-1]
    return f"${stem}_{{{index}}}$" if index else f"${stem}$"


def _legend(figure: Figure, axes: Axes) -> None:
    """Explain marks and lines above the figure, where no point can hide the words."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 4))


def _rows(scores: Sequence[StudyScore]) -> list[str]:
    """Return the conditions of scores, in the order of the table."""
    return list(dict.fromkeys(score.condition for score in scores))


def _points(
    axes: Axes, scores: Sequence[StudyScore], rows: Sequence[str], *, colour: str, shift: float
) -> None:
    """Draw one point with its 95 % error bar for each score, on its condition's line."""
    place = [rows.index(s.condition) + shift for s in scores]
    bars = [1.96 * (s.std_error or 0.0) for s in scores]
    values = [s.value for s in scores]
    axes.errorbar(values, place, xerr=bars, fmt="o", ms=3, lw=0.9, color=colour)


def _frame(axes: Axes, rows: Sequence[str], label: str) -> None:
    axes.set_yticks(range(len(rows)), rows)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlabel(label)
    axes.grid(axis="x", color="#e6e6e6", lw=0.7)
    axes.set_axisbelow(True)


def _figure(rows: int, columns: int = 1) -> tuple[Figure, list[Axes]]:
    figure = Figure((WIDTH_INCH, 1.0 + ROW_INCH * max(rows, 3)), layout="constrained")
    grid = figure.subplots(1, columns, sharey=True, squeeze=False)
    return figure, list(grid[0])


def coverage(scores: Sequence[StudyScore], *, estimator: str = "selected") -> Figure | None:
    """Return how often 50, 90 and 95 % depth intervals hold the truth, inside and beyond."""
    depth = [s for s in scores if s.estimator == estimator and s.statistic.startswith("coverage")]
    if not depth:
        return None
    rows = _rows(depth)
    figure, panels = _figure(len(rows), 2)
    for axes, part in zip(panels, ("inside", "beyond"), strict=True):
        for level, colour in zip(LEVELS, (GREEN, RED, BLUE), strict=True):
            statistic = f"coverage{100 * level:.0f}"
            chosen = [s for s in depth if s.subject == f"depth {part}" and s.statistic == statistic]
            axes.axvline(level, color=colour, lw=0.7, ls=":")
            _points(axes, chosen, rows, colour=colour, shift=0.0)
            name = f"{100 * level:.0f} % intervals (dotted: as stated)"
            axes.plot([], [], "o", ms=3, color=colour, label=name)
        _frame(axes, rows, f"share of intervals that hold the true depth,\n{PARTS[part]}")
        axes.set_xlim(0.2, 1.02)
    _legend(figure, panels[0])
    return figure


PARTS = {"inside": "calibrated depths", "beyond": "depths beyond those calibrated"}


def pulls(scores: Sequence[StudyScore]) -> Figure | None:
    """Return the rms of identified parameters' pulls."""
    label = (
        "rms of (estimate − truth) / u, parameters identified by rows (line: 1, as it should be)"
    )
    return _spread(scores, "pull_rms", label, 1.0)


def _spread(
    scores: Sequence[StudyScore], statistic: str, label: str, ideal: float
) -> Figure | None:
    wanted = [s for s in scores if s.statistic == statistic and s.estimator == "posterior"]
    if not wanted:
        return None
    rows, subjects = _rows(wanted), list(dict.fromkeys(s.subject for s in wanted))
    figure, (axes,) = _figure(len(rows))
    for k, subject in enumerate(subjects):
        shift = 0.6 * (k / max(len(subjects) - 1, 1) - 0.5)
        colour = (BLUE, RED, GREEN, "#CC79A7", "#E69F00", MUTED)[k % 6]
        _points(axes, [s for s in wanted if s.subject == subject], rows, colour=colour, shift=shift)
        axes.plot([], [], "o", ms=3, color=colour, label=_name(subject))
    axes.axvline(ideal, color=INK, lw=0.7)
    _frame(axes, rows, label)
    _legend(figure, axes)
    return figure


def efficiency(scores: Sequence[StudyScore]) -> Figure | None:
    """Return Cramer-Rao bound over mean square error of L_b, by estimator, on clean rows."""
    wanted = [
        s
        for s in scores
        if s.statistic == "efficiency"
        and s.subject == "baseline_mm"
        and s.condition in GROUPS["default"]
    ]
    if not wanted:
        return None
    rows = _rows(wanted)
    figure, (axes,) = _figure(len(rows))
    for k, (estimator, (words, colour)) in enumerate(ESTIMATORS.items()):
        chosen = [s for s in wanted if s.estimator == estimator]
        _points(axes, chosen, rows, colour=colour, shift=0.15 * (k - 1.5))
        axes.plot([], [], "o", ms=3, color=colour, label=words)
    axes.axvline(1.0, color=INK, lw=0.7)
    label = (
        "least variance possible (Cramér-Rao) / mean square error, of $L_{b}$ (line: 1, efficient)"
    )
    _frame(axes, rows, label)
    axes.set_xscale("log")
    axes.set_xlim(1e-3, 3.0)
    _legend(figure, axes)
    return figure


def ranks(histograms: Mapping[str, Mapping[str, np.ndarray]]) -> Figure | None:
    """Return histograms of the truth's rank in its posterior, flat if the posterior is right.

    Parameters
    ----------
    histograms
        Ranks, 0 to 1, by condition and parameter.
    """
    if not histograms:
        return None
    columns = max(len(one) for one in histograms.values())
    size = (WIDTH_INCH, 1.5 * len(histograms))
    figure = Figure(size, layout="constrained")
    grid = figure.subplots(len(histograms), columns, squeeze=False)
    for line, (condition, one) in zip(grid, histograms.items(), strict=True):
        for axes in line[len(one) :]:
            axes.set_axis_off()
        for axes, (name, values) in zip(line, one.items(), strict=False):
            axes.hist(values, bins=10, range=(0, 1), color=BLUE, alpha=0.7)
            expected = len(values) / 10
            # Each bin holds a binomial count: 95 % of them lie within this band.
            band = 1.96 * np.sqrt(expected * 0.9)
            axes.axhspan(expected - band, expected + band, color=MUTED, alpha=0.25)
            axes.set_title(f"{condition}\n{_name(name)}", fontsize=6)
            axes.set_yticks([])
    figure.supxlabel(
        "rank of the truth among the posterior's draws; grey: where 95 % of the bars of a right "
        "posterior lie",
        fontsize=7,
    )
    return figure


FIGURES: Mapping[str, Callable[[Sequence[StudyScore]], Figure | None]] = MappingProxyType(
    {
        "coverage": coverage,
        "coverage-averaged": partial(coverage, estimator="averaged"),
        "pulls": pulls,
        "efficiency": efficiency,
    }
)


def svg(figure: Figure) -> bytes:
    """Return a figure as SVG, the same bytes for the same scores."""
    buffer = io.BytesIO()
    with rc_context(_STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def styled(draw: Callable[[], Figure | None]) -> bytes | None:
    """Return what a figure function draws, in the study's style, as SVG; None if it has nothing."""
    with rc_context(_STYLE):
        figure = draw()
        return None if figure is None else svg(figure)
