"""Models side by side, and the rule that selects one."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from calib.fit.compare import CLEARLY, NOTICEABLY, ModelScore
from calib.fit.importance import K_HAT_LIMIT
from calib.report.blocks import EMPTY, Block, Cell, Chapter, Items, Paragraph, number, table, words
from calib.report.context import ReportContext
from calib.report.numbers import decimals, percent, signed
from calib.results.calibration import Calibration
from calib.uncertainty.format import fixed

HEADS = (
    "Model",
    "Free",
    "LOO ± standard error",
    "Stacking weight",
    "Average weight",
    "AICc",
    "BIC",
    "Depth, left out / %",
    "Depth, validation / %",
    "Largest Pareto k",
    "Rows refitted",
)


def comparison(c: Calibration, _: ReportContext) -> Chapter | None:
    """Write the comparison of models."""
    if c.gaze is None or c.gaze.comparison is None:
        return None
    found = c.gaze.comparison
    fits = c.gaze.robust
    rows = [
        _row(score, free=len(fits[score.model].names), chosen=score.model == found.selected)
        for score in found.scores
    ]
    blocks: list[Block] = [
        Paragraph(
            Markup(
                "<strong>The rule.</strong> Selected is the model with the fewest free parameters "
                "that predicts left-out rows nearly as well as the best one: its LOO is lower by "
                "no more than {} standard error of the difference, or by less than {} nats. A "
                "richer model must earn its parameters. <strong>Here:</strong> {}."
            ).format(f"{CLEARLY:g}", f"{NOTICEABLY:g}", found.reason)
        ),
        table(
            "Models side by side",
            HEADS,
            rows,
            note="✓: selected. Free: parameters. LOO is the expected log density of the encoder's "
            "reading of a row that the fit has not seen, summed over rows: higher is better. AICc "
            "and BIC: lower is better; no AICc where the rows are too few for it. Stacking weights "
            "mix the models' predictions of left-out rows best; average weights (pseudo-BMA+) say "
            "how far the rows leave open which model is right, and average depths over the models. "
            "Depth errors are root mean squares, of groups of rows left out and of the validation "
            f"rows. Rows with a Pareto k above {K_HAT_LIMIT:g} are predicted by a refit without "
            f"them{_refitted(found.scores)}.",
            dense=True,
            sortable=True,
        ),
    ]
    if c.gaze.refused:
        blocks += [
            Paragraph(Markup("<strong>Not fitted</strong>")),
            Items(tuple(f"{name}: {reason}" for name, reason in c.gaze.refused.items())),
        ]
    return Chapter("comparison", "Comparison of the models", tuple(blocks))


def _refitted(scores: Sequence[ModelScore]) -> str:
    """Return which rows were refitted, in words that go on a sentence."""
    parts = []
    for score in scores:
        if score.refitted:
            more = " …" if len(score.refitted) > MOST_NAMED else ""
            parts.append(f"{score.model}: {', '.join(score.refitted[:MOST_NAMED])}{more}")
    return f" ({'; '.join(parts)})" if parts else ""


MOST_NAMED = 10


def _row(s: ModelScore, *, free: int, chosen: bool) -> tuple[Cell, ...]:
    return (
        words(s.model, mark="good" if chosen else ""),
        number(str(free), free),
        number(f"{signed(fixed(s.loo, 1))} ± {fixed(s.loo_se, 1)}", s.loo),
        decimals(s.weight, 2),
        decimals(s.averaging_weight, 2),
        EMPTY if s.aicc is None else decimals(s.aicc, 1),
        decimals(s.bic, 1),
        percent(s.cv_depth_rms_rel),
        percent(s.validation_depth_rms_rel),
        decimals(float(s.pareto_k.max()), 2),
        number(str(len(s.refitted)), len(s.refitted)),
    )
