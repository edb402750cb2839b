"""Residuals: what each model leaves of the calibration rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from calib.fit.robust import RobustFit
from calib.report.plotting import (
    BLACK,
    GREY,
    LIGHT,
    Drawing,
    Margins,
    cloud,
    in_house_style,
    label_rows,
    legend,
    new_figure,
    plot_style,
)
from calib.rows.observations import Observations

RESIDUAL = "residual / mrad"


@in_house_style
def draw_residuals_by_row(rows: Observations, fits: Sequence[RobustFit]) -> Drawing:
    """Draw the residual of each row under each model; outliers ringed."""
    figure = new_figure(height_in=3.0)
    axes = figure.subplots()
    place = np.arange(len(rows))
    for k, fit in enumerate(fits):
        shift = 0.16 * (k - (len(fits) - 1) / 2) if len(rows) <= 60 else 0.0
        if len(rows) <= 60:
            axes.vlines(
                place + shift, 0, fit.residual_mrad, color=plot_style(fit.model).colour, lw=1.2
            )
        cloud(axes, place + shift, fit.residual_mrad, plot_style(fit.model), label=fit.model)
        _ring(axes, place + shift, fit, rows)
    axes.axhline(0, color=BLACK, lw=0.8)
    label_rows(axes, rows.ids, what="row")
    axes.set_ylabel(RESIDUAL)
    legend(figure, axes)
    return Drawing(
        figure,
        f"Residuals of {len(rows)} rows. {_ranges(fits)}",
        {"id": rows.ids, **_columns(fits)},
    )


@in_house_style
def draw_residuals_against(rows: Observations, fits: Sequence[RobustFit]) -> Drawing:
    """Draw residuals against depth and against the direction in C1."""
    figure = new_figure(height_in=3.0, margins=Margins(between=0.06))
    panels = figure.subplots(1, 2, sharey=True)
    abscissae = {"reference depth / mm": rows.z_mm, "x1c = tan α1": rows.x1c}
    for axes, (name, x) in zip(panels, abscissae.items(), strict=True):
        for fit in fits:
            cloud(axes, x, fit.residual_mrad, plot_style(fit.model), label=fit.model)
            _ring(axes, x, fit, rows)
        axes.axhline(0, color=BLACK, lw=0.8)
        axes.set_xlabel(name)
    panels[0].set_ylabel(RESIDUAL)
    legend(figure, panels[0])
    return Drawing(
        figure,
        f"Residuals against reference depth and against x1c. {_ranges(fits)}",
        {"id": rows.ids, "z_mm": rows.z_mm, "x1c": rows.x1c, **_columns(fits)},
    )


@in_house_style
def draw_scatter(
    sigma_mrad: Mapping[str, float], *, step_mrad: float | None, reading_mrad: float
) -> Drawing:
    """Draw what each fit leaves beside what the encoder alone accounts for.

    Parameters
    ----------
    sigma_mrad
        Standard deviation of the residuals, by fit.
    step_mrad, reading_mrad
        Of one encoder count, uniform; of a whole reading of the encoder as stated.
    """
    figure = new_figure(height_in=0.95 + 0.3 * len(sigma_mrad), margins=Margins(left=1.35))
    axes = figure.subplots()
    for y, (name, sigma) in enumerate(sigma_mrad.items()):
        _bar(axes, name, sigma, y)
    axes.axvline(reading_mrad, color=BLACK, lw=1.2, label="gaze angle, as stated")
    if step_mrad is not None and abs(step_mrad / reading_mrad - 1) > 0.02:
        axes.axvline(
            step_mrad, color=BLACK, lw=1.2, ls=":", label="one count of the encoder, uniform"
        )
    legend(figure, axes)
    axes.set_yticks(range(len(sigma_mrad)), list(sigma_mrad))
    axes.set(
        xlabel="standard deviation of the residuals / mrad", ylim=(len(sigma_mrad) - 0.4, -0.6)
    )
    axes.set_xlim(0, 1.12 * max([*sigma_mrad.values(), reading_mrad]))
    axes.grid(visible=False, axis="y")
    left = "; ".join(f"{name} {sigma:.3g}" for name, sigma in sigma_mrad.items())
    return Drawing(
        figure,
        f"Standard deviation of the residuals in mrad: {left}. The gaze angle as stated "
        f"accounts for {reading_mrad:.2g} mrad.",
        {"fit": tuple(sigma_mrad), "sigma_mrad": tuple(sigma_mrad.values())},
    )


def _bar(axes: Axes, name: str, sigma: float, y: int) -> None:
    """Draw what one fit leaves."""
    style = plot_style(name.split("/", maxsplit=1)[0]) if name.endswith("/robust") else None
    colour, marker = (GREY, "d") if style is None else (style.colour, style.marker)
    axes.plot([0, sigma], [y, y], color=LIGHT, lw=5, solid_capstyle="butt")
    axes.plot(sigma, y, marker, color=colour, ms=7)
    axes.annotate(
        f"{sigma:.3g}",
        (sigma, y),
        (8, 0),
        textcoords="offset points",
        va="center",
        fontsize=8,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8},
    )


def _ring(axes: Axes, x: np.ndarray, fit: RobustFit, rows: Observations) -> None:
    """Ring the rows that the fit names as outliers."""
    named = set(fit.outliers)
    out = np.array([i in named for i in rows.ids])
    axes.plot(x[out], fit.residual_mrad[out], "o", mfc="none", mec=BLACK, ms=11, mew=1.2)


def _columns(fits: Sequence[RobustFit]) -> dict[str, np.ndarray]:
    return {f"{fit.model}_residual_mrad": fit.residual_mrad for fit in fits}


def _ranges(fits: Sequence[RobustFit]) -> str:
    """Return the range of each model's residuals in words."""
    parts = [
        f"{fit.model}: from {fit.residual_mrad.min():.2g} to {fit.residual_mrad.max():.2g} mrad, "
        f"standard deviation {fit.sigma_mrad:.2g} mrad"
        for fit in fits
    ]
    return "; ".join(parts) + "."
