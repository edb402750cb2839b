"""Gate and warnings on mistakes, on structure of residuals and on priors that rows stretch."""

from __future__ import annotations

from calib.core.gate import Gate
from calib.diagnosis.findings import Attempt, Diagnosis
from calib.diagnosis.structure import Structure, structured
from calib.geometry.parameters import INDEX, PARAMETERS


def diagnosis_gate(found: Diagnosis) -> Gate:
    """Gate on mistakes that the rows show and that move depths."""
    cause = found.left_out
    if cause is None:
        detail = "no mistake is known that explains the rows better and moves depths by their u"
        return Gate("diagnosis", passed=True, detail=detail)
    return Gate(
        "diagnosis",
        passed=False,
        detail=f"{found.words(cause)}. It moves a depth by {cause.effect:.2g} u",
    )


def diagnosis_warnings(found: Diagnosis | None, correction: Attempt | None) -> list[str]:
    """Return what the reader should know of mistakes, residuals and priors."""
    texts = [] if found is None else _structure(found)
    if correction is not None:
        texts.append(f"the rows are corrected ([corrections]): {correction.text}")
    if found is not None:
        texts += [
            f"the rows show {found.words(cause)}"
            for cause in found.causes[:1]
            if cause is not found.left_out
        ]
    return texts


def structure_words(shown: Structure) -> str:
    """Return what residuals follow."""
    place = "" if shown.at is None else f" at row {shown.at}"
    return f"they follow {shown.against}{place} (p = {shown.probability:.1g} by chance)"


def _structure(found: Diagnosis) -> list[str]:
    texts = []
    shown = structured(found.structure)
    if shown is not None:
        texts.append(
            f"residuals of {found.model} have structure: {structure_words(shown)}; look at the "
            "figures of residuals in the report"
        )
    texts += [
        f"{s.name} ({PARAMETERS[INDEX[s.name]].meaning}) lies {s.deviations:.1f} standard "
        "deviations out in its prior: rows and prior contradict each other; check what was "
        "stated of the lens, the encoder and the reference before you believe either"
        for s in found.stretched
    ]
    return texts
