"""What the rows tell of each model, and the correlations of the selected one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from calib.fit.identifiability import UNDETERMINED, Identifiability
from calib.report.numbers import plain_symbol, signed
from calib.report.plotting import (
    BLACK,
    GREY,
    Drawing,
    Margins,
    in_house_style,
    new_figure,
    plot_style,
)
from calib.uncertainty.format import fixed, significant

BEYOND = 3.0
"""Factor beyond the largest finite standard deviation at which an infinite one is drawn."""


@in_house_style
def draw_identifiability(told: Sequence[Identifiability]) -> Drawing:
    """Draw the combinations of all models, and the correlations of the first one's parameters."""
    size = max(0.42 * len(told), 0.34 * len(told[0].names))
    figure = new_figure(
        height_in=1.05 + max(size, 1.1), margins=Margins(left=0.95, between=0.22, top=0.35)
    )
    spectrum, correlations = figure.subplots(1, 2, width_ratios=(1.7, 1))
    _draw_combinations(spectrum, told)
    _draw_correlations(correlations, told[0])
    each = [(found, c) for found in told for c in found.combinations]
    words = "; ".join(
        f"{found.model} from {significant(found.combinations[0].std, digits=2)} to "
        f"{significant(found.combinations[-1].std, digits=2)}"
        for found in told
    )
    return Drawing(
        figure,
        "Standard deviation of each combination of parameters from the rows alone, in units of "
        f"what is known beforehand: {words}. Correlations of the parameters of {told[0].model}.",
        {
            "model": [found.model for found, _ in each],
            "combination": [" ".join(c.names) for _, c in each],
            "singular_value": [c.singular_value for _, c in each],
            "std_rows": [c.std for _, c in each],
            "std_rows_and_sweep": [c.std_with_sweep for _, c in each],
            "std": [c.std_with_priors for _, c in each],
            "told_by": [c.told_by for _, c in each],
        },
    )


def _draw_combinations(axes: Axes, told: Sequence[Identifiability]) -> None:
    """Draw the standard deviation of each combination: rows alone, and with all that is known."""
    finite = [c.std for found in told for c in found.combinations if np.isfinite(c.std)]
    edge = BEYOND * max(*finite, UNDETERMINED)
    for strip, found in enumerate(told):
        style = plot_style(found.model)
        places = strip + SPREAD * np.linspace(-1, 1, len(found.combinations))
        for y, c in zip(places, found.combinations, strict=True):
            alone = min(c.std, edge)
            if c.std_with_priors < MOVED * alone:
                axes.plot([c.std_with_priors, alone], [y, y], color=style.colour, lw=1.0)
                axes.plot(c.std_with_priors, y, marker="|", color=style.colour, ms=9)
            marker = style.marker if np.isfinite(c.std) else ">"
            face = style.colour if c.told_by == "rows" else "white"
            axes.plot(alone, y, marker=marker, color=style.colour, mfc=face)
    axes.axvline(UNDETERMINED, color=BLACK, lw=0.9, ls="--")
    axes.set_xscale("log")
    axes.set_yticks(range(len(told)), [found.model for found in told])
    axes.set_ylim(len(told) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("standard deviation / what is known beforehand")
    axes.set_title("Combinations of parameters")


def _draw_correlations(axes: Axes, found: Identifiability) -> None:
    names = [plain_symbol(name) for name in found.names]
    axes.imshow(found.correlation, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    for (i, j), value in np.ndenumerate(found.correlation):
        strong = abs(value) > STRONG
        text = signed(fixed(float(value), DECIMALS if abs(value) < NEARLY_ONE else MORE_DECIMALS))
        axes.text(j, i, text if i != j else "1", ha="center", va="center", fontsize=7,
                  color="white" if strong else BLACK)  # fmt: skip
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(length=0)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_title(f"Correlations, {found.model}", color=BLACK)
    axes.title.set_parse_math(False)
    axes.spines["left"].set_color(GREY)


MOVED = 0.9
"""Share of a standard deviation below which its way to the smaller one can be seen."""

SPREAD = 0.3
"""Half height of a model's strip, over which its combinations are spread."""

STRONG = 0.6
"""Correlation beyond which its cell is so dark that it needs white figures."""

NEARLY_ONE, DECIMALS, MORE_DECIMALS = 0.995, 2, 4
"""Near one, two decimals would round a correlation to it."""
