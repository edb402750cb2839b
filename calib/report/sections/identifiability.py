"""Which parameters the rows identify, which they do not, and what would help."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from calib.fit.identifiability import UNDETERMINED, Combination, Identifiability
from calib.fit.information import RULER
from calib.report.blocks import (
    Block,
    Cell,
    Chapter,
    Notice,
    Paragraph,
    Table,
    Text,
    number,
    table,
    words,
)
from calib.report.context import ReportContext
from calib.report.figures.identifiability import draw_identifiability
from calib.report.numbers import digits, factor, percent, signed, symbol, unit
from calib.report.plotting import picture
from calib.report.sections.pick import selected
from calib.results.calibration import Calibration
from calib.uncertainty.format import significant

IDENTIFIED_BY = {"rows": "the rows", "sweep": "the sweep", "prior": "the prior"}
"""What identifies a parameter, in the words of the report; several stand as they are."""


def identifiability(c: Calibration, _: ReportContext) -> Chapter | None:
    """Write which parameters the rows identify."""
    if c.gaze is None or not c.gaze.identifiability:
        return None
    chosen = selected(c.gaze)
    told = sorted(c.gaze.identifiability.values(), key=lambda found: found.model != chosen)
    first = told[0]
    blocks: list[Block] = [
        Paragraph(
            Markup(
                "Parameters that move the readings alike cannot be distinguished, however exact "
                "the rows are. So the rows' information is taken apart into combinations of "
                "parameters, and each is held against what is known of any rig beforehand: {} mm "
                "of <i>L</i><sub>b</sub>, {} mrad of <i>δ</i><sub>2</sub>, of the others their "
                "default prior. The rows do not identify a combination that they alone leave less "
                "certain than that. This, and strong correlation, is no fault as long as depth "
                "does not hang on it: the check is on the predicted uncertainty of depth."
            ).format(f"{RULER:g}", f"{RULER:g}")
        ),
        *_verdict(first),
        _models(told, chosen),
        _parameters(first),
        _combinations(first),
        picture("combinations", draw_identifiability(told), _caption(first)),
    ]
    return Chapter("identifiability", "Identifiability", tuple(blocks))


def _verdict(found: Identifiability) -> list[Block]:
    """Return what the model's rows do not identify and what to do about it."""
    if not found.open:
        by = "rows and yaw sweep" if found.has_sweep else "the rows alone"
        title = f"All parameters of {found.model} are identified by {by}"
        return [Notice("good", title, _swept(found))]
    return [
        Notice(
            "note",
            _told(c),
            Markup(
                "{} The depths of the rows are known to {} % all the same. What would "
                "identify them: {}."
            ).format(
                _held(found, c),
                significant(100 * found.depth_std_rel, digits=2),
                ", or ".join(c.remedies),
            ),
        )
        for c in found.open
    ]


def _swept(found: Identifiability) -> Text:
    """Return which parameters the sweep identifies, and how far rows and sweep know them."""
    parts = [
        Markup("{} ({} {} by the rows alone, {} {} with it)").format(
            symbol(name),
            digits(found.rows_std[i] * factor(name), 2).text,
            unit(name),
            digits(found.sweep_std[i] * factor(name), 2).text,
            unit(name),
        )
        for i, name in enumerate(found.names)
        if found.decided_by[i] == "sweep"
    ]
    return Markup("Identified by the sweep: {}.").format(Markup(", ").join(parts)) if parts else ""


def _held(found: Identifiability, c: Combination) -> Markup:
    """Return how far the priors hold the parameters of an open combination."""
    held = [
        Markup("{} to {} {}").format(symbol(name), digits(std * factor(name), 2).text, unit(name))
        for name, std, who in zip(found.names, found.std, found.decided_by, strict=True)
        if name in c.names and "prior" in who
    ]
    if not held:
        return Markup("")
    return Markup("Meanwhile the priors hold {}.").format(Markup(" and ").join(held))


def _told(c: Combination) -> Text:
    symbols = [symbol(name) for name in c.names]
    if len(symbols) == 1:
        return Markup("These targets hold hardly any information on {}").format(symbols[0])
    before = Markup(", ").join(symbols[:-1])
    return Markup("These targets cannot distinguish {} from {}").format(before, symbols[-1])


def _models(told: list[Identifiability], chosen: str | None) -> Table:
    """Return the table of all models."""
    rows = []
    for found in told:
        by = [c.told_by for c in found.combinations]
        mine = found.model == chosen
        rows.append(
            (
                words(f"{found.model} (selected)" if mine else found.model),
                *(number(str(by.count(who)), by.count(who)) for who in ("rows", "sweep", "prior")),
                digits(found.condition, 2),
                percent(found.depth_std_rel),
            )
        )
    return table(
        "Model by model",
        (
            "Model",
            "Combinations identified by the rows",
            "by the sweep",
            "left to the prior",
            "Condition number",
            "Depths of the rows uncertain by at most / %",
        ),
        rows,
        note="The last column is the standard uncertainty of depth from the parameters alone, as "
        "predicted by rows, sweep and priors together. The check named identified is on that of "
        "the selected model.",
    )


def _parameters(found: Identifiability) -> Table:
    """Return the table of a model's parameters by what identifies them."""
    times = np.array([factor(name) for name in found.names])
    columns = [found.scale, found.rows_std, found.std]
    head = ["Symbol", "Unit", "Beforehand", "Rows alone", "and priors", "Identified by"]
    if found.has_sweep:
        columns.insert(2, found.sweep_std)
        head.insert(4, "and sweep")
    rows = [
        (
            words(symbol(name)),
            words(unit(name)),
            *(digits(float(column[i] * times[i]), 2) for column in columns),
            identified_cell(found.decided_by[i]),
        )
        for i, name in enumerate(found.names)
    ]
    return table(
        Markup("<em>{}</em>: how far each parameter is known").format(found.model),
        head,
        rows,
        note="Standard deviations as predicted at the robust estimate. Those of the posterior are "
        "larger where few rows say little of their own noise, and where intrinsics and stereo "
        "extrinsics have errors that all rows share.",
    )


def identified_cell(who: str) -> Cell:
    """Return a cell that says what identifies a parameter."""
    return words(IDENTIFIED_BY.get(who, who), mark="bad" if who == "prior" else "")


def _combinations(found: Identifiability) -> Table:
    """Return the table of a model's combinations."""
    head = ["Change that the rows' noise hides", "Singular value", "Rows alone"]
    head += ["and priors", "Identified by"]
    if found.has_sweep:
        head.insert(3, "and sweep")
    rows = []
    for c in found.combinations:
        known = [c.std, c.std_with_sweep, c.std_with_priors]
        if not found.has_sweep:
            del known[1]
        rows.append(
            (
                words(_moved(c, found)),
                digits(c.singular_value, 2),
                *(digits(std, 2) for std in known),
                identified_cell(c.told_by),
            )
        )
    return table(
        Markup("<em>{}</em>: its combinations").format(found.model),
        head,
        rows,
        note="The best known first. Parameters that move together as in the first column move by "
        "one standard deviation of the rows alone. Singular values of the rows' information, and "
        "the standard deviations, which are their inverse, are in units of what is known "
        f"beforehand: above {UNDETERMINED:g} a combination is not identified by the rows.",
    )


def _moved(c: Combination, found: Identifiability) -> Text:
    """Return by how much the parameters of a combination move together."""
    size = c.std if np.isfinite(c.std) else 1.0
    parts = []
    for name in c.names:
        i = found.names.index(name)
        step = size * c.direction[i] * found.scale[i] * factor(name)
        text = signed(significant(float(step), digits=2))
        parts.append(
            Markup("{} {}{} {}")
            .format(symbol(name), "" if step < 0 else "+", text, unit(name))
            .rstrip()
        )
    moved = Markup(", ").join(parts)
    return moved if np.isfinite(c.std) else Markup("{}, and any multiple").format(moved)


def _caption(found: Identifiability) -> str:
    swept = "sweep and priors" if found.has_sweep else "the priors"
    return (
        "Left: each mark is a combination of a model's parameters, placed by its standard "
        f"deviation from the rows alone; the line leads to the tick where {swept} bring it. "
        "Hollow marks, right of the dashed line, are not identified by the rows. A tick that "
        "stays right of the line, or near it, is known no better than before the calibration. "
        "Right: correlations with all that is known. Near ±1 two parameters are known by their sum "
        "or difference only."
    )
