"""The posterior, whether its chains have converged, and the second computation."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from calib.fit.chains import ESS_GOAL, R_HAT_LIMIT
from calib.fit.importance import K_HAT_LIMIT
from calib.fit.posterior import Posterior
from calib.report.blocks import Block, Cell, Chapter, DefinitionList, Paragraph, Table, table, words
from calib.report.context import ReportContext
from calib.report.figures.posterior import draw_corner
from calib.report.numbers import bounds, decimals, estimate, factor, signed, symbol, unit
from calib.report.plotting import picture
from calib.report.sections.pick import selected
from calib.results.calibration import Calibration
from calib.uncertainty.format import fixed


def posterior(c: Calibration, _: ReportContext) -> Chapter | None:
    """Write the posterior of each model."""
    if c.gaze is None or not c.gaze.posterior:
        return None
    chosen = selected(c.gaze)
    ordered = sorted(c.gaze.posterior.values(), key=lambda p: p.model != chosen)
    blocks: list[Block] = [
        Paragraph(
            "The posterior was drawn by emcee: several independent ensembles of walkers, stopped "
            "when they hold enough autocorrelation times. R-hat compares the ensembles. An "
            "importance sample, computed independently, has to give the same means and spreads."
        )
    ]
    for p in ordered:
        if p.model == chosen or chosen is None:
            blocks.append(
                picture(
                    f"corner-{p.model}",
                    draw_corner(p),
                    Markup(
                        "Posterior of <em>{}</em>: each parameter (diagonal; lines at 2.5, 50 and "
                        "97.5 %) and each pair (regions of one and two standard deviations). A "
                        "narrow slanted ridge is a pair that the data cannot distinguish; two "
                        "peaks, a calibration with two answers; ragged regions, too few draws."
                    ).format(p.model),
                )
            )
        blocks += [_table(p), DefinitionList(_facts(p))]
    return Chapter("posterior", "Posterior and convergence", tuple(blocks))


def _table(p: Posterior) -> Table:
    rows: list[tuple[Cell, ...]] = []
    std = np.sqrt(np.diag(p.covariance))
    for i, name in enumerate(p.names):
        times, (low, _, high) = factor(name), p.quantiles[i]
        rows.append(
            (
                words(_quantity(name)),
                estimate(p.mean[i], std[i], factor=times),
                bounds(low, high, std[i], factor=times),
                decimals(p.tau[i], 0),
                _limited(p.ess_bulk[i], 0, good=p.ess_bulk[i] >= ESS_GOAL),
                _limited(p.ess_tail[i], 0),
                _limited(p.r_hat[i], 4, good=p.r_hat[i] < R_HAT_LIMIT),
                estimate(p.importance_mean[i], p.importance_std[i], factor=times),
            )
        )
    heads = (
        "Parameter",
        "Mean ± u",
        "95 % interval, equal tails",
        "τ / steps",
        "Effective draws, bulk",
        "Effective draws, tails",
        "R-hat",
        "Mean ± u by importance sampling",
    )
    return table(
        Markup("Convergence of <em>{}</em>").format(p.model),
        heads,
        rows,
        note=f"τ: autocorrelation time. Wanted: {ESS_GOAL:.0f} effective draws in the bulk, R-hat "
        f"below {R_HAT_LIMIT}.",
        dense=True,
    )


def _quantity(name: str) -> Markup:
    """Return symbol and unit of a parameter."""
    return Markup("{} / {}").format(symbol(name), unit(name)) if unit(name) else symbol(name)


def _limited(value: float, count: int, *, good: bool = True) -> Cell:
    return decimals(float(value), count, mark="" if good else "bad")


def _facts(p: Posterior) -> tuple[tuple[str, str], ...]:
    ensembles, kept, _ = p.draws.shape
    return (
        ("Chain", "converged" if p.converged else "NOT converged"),
        ("Length", f"{ensembles} ensembles of {p.steps} steps; {ensembles * kept} draws kept"),
        ("Acceptance", f"{fixed(100 * p.acceptance, 1)} % of the proposals"),
        (
            "Importance sample",
            f"Pareto k-hat {signed(fixed(p.k_hat, 2))} (reliable below {K_HAT_LIMIT:g}), "
            f"{p.importance_ess:.0f} effective draws",
        ),
        (
            "Agreement of the two",
            f"{'yes' if p.agrees else 'NO'}: largest difference of the means "
            f"{fixed(p.agreement, 2)} of what is allowed",
        ),
    )
