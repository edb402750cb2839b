"""What may have been done wrong, and what the rows say of it."""

from __future__ import annotations

from calib.diagnosis.engine import DECISIVE
from calib.diagnosis.findings import Attempt, Cause, Diagnosis, scatter_words
from calib.diagnosis.structure import structured
from calib.report.blocks import Block, Chapter, Items, Notice, Paragraph, number, table, words
from calib.report.context import ReportContext
from calib.report.figures.diagnosis import draw_cause
from calib.report.numbers import signed
from calib.report.plotting import picture
from calib.report.prose import capital, typeset
from calib.results.calibration import Calibration
from calib.uncertainty.format import significant, with_uncertainty


def diagnosis(c: Calibration, _: ReportContext) -> Chapter | None:
    """Write the diagnosis."""
    if c.gaze is None or c.gaze.diagnosis is None:
        return None
    found = c.gaze.diagnosis
    blocks: list[Block] = [Paragraph(_finding(found))]
    for cause in found.causes:
        blocks += _named(found, cause)
    if found.causes:
        blocks.append(_picture(found))
    if found.tried:
        blocks.append(_table(found))
    if found.structure:
        blocks.append(_structure(found))
    return Chapter("diagnosis", "What may have been done wrong", tuple(blocks))


def _picture(found: Diagnosis) -> Block:
    """Return the picture of residuals without and with the best cause, and one beside it."""
    first = found.causes[0]
    second = next((cause for cause in found.causes if cause.beside == first.name), None)
    shown = "the rows" if first.seen_in == "rows" else "independent depths and lengths"
    text = f"by {found.model} alone and with {first.name} as a further parameter"
    if second is not None:
        text = (
            f"by {found.model} alone, with {first.name} as a further parameter, and with "
            f"{second.name} beside it"
        )
    return picture(
        "cause",
        draw_cause(first, second),
        f"Residuals of {shown}, {text}. With the right cause they scatter about zero "
        "without order.",
    )


def _finding(found: Diagnosis) -> str:
    if not found.tried:
        return "The rows are too few to tell mistakes in taking them from their noise."
    count = len(found.tried)
    if not found.causes:
        return (
            f"Of {count} mistakes that are often made, none explains the rows decisively better "
            f"than the models do. Slips too small to matter, and those that a model follows, "
            "remain hidden."
        )
    first = found.causes[0]
    before, after = first.noise_scale
    what, expected = scatter_words(first.seen_in)
    text = (
        f"Of {count} mistakes that are often made, {first.name} explains {_looked_at(first)} best: "
        f"{what} are {before:.2g} times {expected} without it, {after:.2g} times with it."
    )
    if found.others(first):
        text += " Others explain them about as well; a measurement that distinguishes is named."
    beside = [cause.name for cause in found.causes if cause.beside]
    if beside:
        text += f" Once that is allowed for, the rows show {' or '.join(beside)} as well."
    return text


def _looked_at(cause: Cause) -> str:
    if cause.seen_in == "both":
        return "the rows and independent depths and lengths together"
    return "the rows" if cause.seen_in == "rows" else "independent depths and lengths"


def _named(found: Diagnosis, cause: Cause) -> list[Block]:
    matters = found.matters(cause)
    blocks: list[Block] = [
        Notice("bad" if matters else "note", cause.name, f"{capital(typeset(cause.text))}.")
    ]
    items = [f"Remedy: {cause.hypothesis.remedy}."]
    if not cause.is_carried:
        items.append(f"Left out, it moves a depth by up to {cause.effect:.2g} of its u.")
    if found.others(cause):
        others = ", ".join(found.others(cause))
        items.append(f"As well it may be {others}. To distinguish: {cause.hypothesis.tells}.")
    return [*blocks, Items(tuple(items))]


_BY = {"rows": "rows", "references": "references", "both": "rows and references"}


def _table(found: Diagnosis) -> Block:
    """Return all that was tried, with what rows and references gave together where it was named."""
    together = [cause for cause in found.causes if cause.seen_in == "both"]
    rows = [
        (
            words(attempt.name),
            words(attempt.at or "", mark=""),
            words(_estimate(attempt)),
            words(_BY[attempt.seen_in]),
            number(signed(f"{attempt.gain:.1f}"), attempt.gain),
        )
        for attempt in (*together, *found.tried)
    ]
    return table(
        f"Mistakes tried (evidence in nats; named from {DECISIVE:g})",
        ("Mistake", "Where", "Estimate", "By", "Evidence"),
        rows,
        sortable=True,
    )


def _structure(found: Diagnosis) -> Block:
    shown = structured(found.structure)
    rows = [
        (
            words(test.against, mark="bad" if test is shown else ""),
            words(test.at or ""),
            number(significant(test.probability, digits=2), test.probability),
        )
        for test in found.structure
    ]
    return table(
        "Residuals against what they should not follow",
        ("Against", "From row", "Probability by chance"),
        rows,
        sortable=True,
    )


def _estimate(attempt: Attempt) -> str:
    if not attempt.std > 0:
        return ""
    unit = attempt.hypothesis.unit.replace("1", "")
    rounded = with_uncertainty(attempt.estimate, attempt.std)
    return f"{signed(rounded.value)} ± {rounded.uncertainty} {unit}".strip()
