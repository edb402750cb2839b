"""The parameters of each model: estimate, uncertainty, and what identifies it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from markupsafe import Markup

from calib.fit.posterior import Posterior
from calib.fit.priors import NOISE_SCALE, NOISE_SCALE_PRIOR
from calib.fit.robust import RobustFit
from calib.geometry.parameters import INDEX, PARAMETERS
from calib.report.blocks import (
    EMPTY,
    NOTHING,
    Block,
    Cell,
    Chapter,
    Paragraph,
    Table,
    Text,
    table,
    words,
)
from calib.report.context import ReportContext
from calib.report.figures.parameters import FitEstimate, draw_estimates
from calib.report.numbers import (
    EFFECTIVE,
    bounds,
    estimate,
    factor,
    meaning,
    plus_minus,
    symbol,
    unit,
)
from calib.report.plotting import picture
from calib.report.sections.identifiability import identified_cell
from calib.report.sections.pick import selected
from calib.results.calibration import Calibration, GazeResult
from calib.results.effective_baseline import effective_baseline, effective_interval
from calib.results.wording import MODELS


def parameters(c: Calibration, context: ReportContext) -> Chapter | None:
    """Write the parameters of each model."""
    if c.gaze is None or not c.gaze.posterior:
        return None
    gaze = c.gaze
    context = replace(context, scaled_priors=gaze.default_priors)
    blocks: list[Block] = [
        Paragraph(
            Markup(
                "All models are one formula with more or fewer parameters free: "
                "<i>z</i> (x1c + cot <i>α</i>) = <i>L</i><sub>b</sub> + <i>Z</i><sub>a</sub> "
                "cot <i>α</i> + <i>e</i> / sin <i>α</i>, with <i>α</i> = α2 + "
                "<i>δ</i><sub>2</sub> for an upright axis and a perfect encoder. The paper's "
                "model, <em>base</em>, frees <i>L</i><sub>b</sub> and <i>δ</i><sub>2</sub> only. "
                "Estimates are means of the posterior, ± its standard deviation, which is the "
                "standard uncertainty u."
            )
        )
    ]
    ordered = sorted(gaze.posterior.values(), key=lambda p: p.model != selected(gaze))
    measured = () if c.images.sweep is None else c.images.sweep.names
    blocks += [_model(gaze, p, measured, context) for p in ordered]
    blocks += [
        Paragraph(
            Markup(
                "Seen near 90°, <i>e</i> / sin <i>α</i> hardly changes: <i>L</i><sub>b</sub> and "
                "<i>e</i> can then be distinguished only by a wide sweep or by prior knowledge. "
                "Their sum, the baseline seen at 90°, is well determined and is what compares "
                "with the paper's <i>L</i><sub>b</sub>. A parameter counts as identified by rows "
                "and sweep if the priors take less than a quarter off its standard uncertainty, "
                "as identified by the prior if they take more than three quarters."
            )
        ),
        picture(
            "estimates",
            draw_estimates(estimates(gaze)),
            "Baseline seen at 90° and encoder zero by every fit; bars are 95 % intervals, hollow "
            "marks the posterior, which should repeat the robust fit of its model. Models whose "
            "intervals exclude each other cannot both be right; a wide bar is a model that has to "
            "call its misfit noise.",
        ),
    ]
    return Chapter("parameters", "Parameters", tuple(blocks))


def _model(
    gaze: GazeResult, posterior: Posterior, measured: Collection[str], context: ReportContext
) -> Table:
    fit = gaze.robust[posterior.model]
    decided = gaze.identifiability[posterior.model].decided_by
    rows = [_row(posterior, fit, i, decided, measured, context) for i in range(len(fit.names))]
    found = effective_baseline(fit.names, posterior.mean[:-1], posterior.covariance[:-1, :-1])
    if found is not None:
        ends = effective_interval(fit.names, posterior.flat)
        rows.append(
            (
                words(symbol(EFFECTIVE)),
                words(meaning(EFFECTIVE)),
                estimate(*found),
                words("mm"),
                bounds(*ends, found[1]) if ends is not None else EMPTY,
                words("derived", mark="quiet"),
                NOTHING,
            )
        )
    rows.append(_noise(posterior, context))
    chosen = " (selected)" if posterior.model == selected(gaze) else ""
    meant = MODELS.get(posterior.model, "")
    return table(
        Markup("Model <em>{}</em>{}: {}").format(posterior.model, chosen, meant),
        (
            "Symbol",
            "Meaning",
            "Estimate ± u",
            "Unit",
            "95 % interval, equal tails",
            "Identified by",
            "Prior",
        ),
        rows,
        note=_tied(fit),
    )


def _tied(fit: RobustFit) -> Text:
    """Return a note on parameters that the priors of others identify."""
    tied = [
        symbol(name)
        for name, who in zip(fit.names, fit.identified_by, strict=True)
        if who != "data" and PARAMETERS[INDEX[name]].prior_std is None
    ]
    if not tied:
        return ""
    one = ("has no prior", "its", "it")
    forms = one if len(tied) == 1 else ("have no priors", "their", "them")
    return Markup(
        "{} {} of {} own: the rows tie {} to parameters that the prior identifies."
    ).format(Markup(" and ").join(tied), *forms)


def _row(
    posterior: Posterior,
    fit: RobustFit,
    i: int,
    decided_by: Sequence[str],
    measured: Collection[str],
    context: ReportContext,
) -> tuple[Cell, ...]:
    name, times = fit.names[i], factor(fit.names[i])
    low, _, high = posterior.quantiles[i]
    u = float(np.sqrt(posterior.covariance[i, i]))
    return (
        words(symbol(name)),
        words(meaning(name)),
        estimate(posterior.mean[i], u, factor=times),
        words(unit(name)),
        bounds(low, high, u, factor=times),
        identified_cell(decided_by[i]),
        words(_prior(name, measured, context)),
    )


def _noise(posterior: Posterior, context: ReportContext) -> tuple[Cell, ...]:
    low, _, high = posterior.quantiles[-1]
    u = float(np.sqrt(posterior.covariance[-1, -1]))
    mean, std = context.priors.get(NOISE_SCALE, NOISE_SCALE_PRIOR)
    return (
        words(symbol(NOISE_SCALE)),
        words(meaning(NOISE_SCALE)),
        estimate(posterior.mean[-1], u),
        words(""),
        bounds(low, high, u),
        NOTHING,
        words(f"{plus_minus(mean, std)}{_origin(NOISE_SCALE, context)}"),
    )


def _prior(name: str, measured: Collection[str], context: ReportContext) -> str:
    """Return the prior and measured knowledge of a parameter in words."""
    known = " and measured by the sweep" if name in measured else ""
    stated = context.priors.get(name)
    std = PARAMETERS[INDEX[name]].prior_std
    if stated is None and name in context.scaled_priors:
        text = plus_minus(*context.scaled_priors[name], factor=factor(name))
        return f"{text} {unit(name)}".rstrip() + f" (default, scaled to the baseline){known}"
    if stated is not None:
        text = plus_minus(*stated, factor=factor(name))
    elif std is not None:
        text = plus_minus(0.0, std, factor=factor(name))
    else:
        return f"none{known}"
    return f"{text} {unit(name)}".rstrip() + _origin(name, context) + known


def _origin(name: str, context: ReportContext) -> str:
    return " (dataset.toml)" if name in context.priors else " (default)"


def estimates(gaze: GazeResult) -> list[FitEstimate]:
    """Return baseline and encoder zero of every fit."""
    found = []
    if gaze.linear is not None:
        found.append(_estimate("base/linear", gaze.linear.values, gaze.linear.covariance))
    if gaze.convex is not None:
        found.append(_estimate("base/convex", gaze.convex.values, gaze.convex.covariance))
    for model, fit in gaze.robust.items():
        p = gaze.posterior[model]
        names, free = fit.names, slice(0, len(fit.names))
        found.append(_estimate(f"{model}/robust", fit.values, fit.covariance, names))
        found.append(_estimate(f"{model}/posterior", p.mean[free], p.covariance[free, free], names))
    return found


def _estimate(
    fit: str,
    values: np.ndarray,
    covariance: np.ndarray,
    names: tuple[str, ...] = ("baseline_mm", "delta2_rad"),
) -> FitEstimate:
    effective = effective_baseline(names, values, covariance)
    std = 1e3 * float(np.sqrt(covariance[1, 1]))
    baseline = effective or (float(values[0]), float(np.sqrt(covariance[0, 0])))
    return FitEstimate(fit, baseline, (1e3 * float(values[1]), std))
