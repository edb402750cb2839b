"""From results to the certificate's data: every word and digit is decided here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from scipy.special import bdtr

from calib.certificate.annexes import annexes, length_limit_words
from calib.certificate.data import CertificateData, CertificateField, Conclusion, Judgement, Result
from calib.certificate.figure import depth_figure
from calib.certificate.inputs import Administration, CalibrationSummary, CertificateInputs
from calib.certificate.numbers import (
    LISTED_CHECKS,
    check_error,
    covariance,
    depth_line,
    judgement,
    length_result,
    listed_checks,
    parameter_results,
)
from calib.results.wording import (
    ADJUSTMENT,
    LINEAR_MEANING,
    MODELS,
    MONTE_CARLO_MEANING,
    NEXT_CALIBRATION,
    NO_ACCREDITATION,
    NO_TOLERANCE,
    NOT_STATED,
    ONE_READING,
    RELATES,
    REPRODUCTION,
    RULES,
    STABILITY,
    SUBTITLE,
    TITLE,
    VERDICTS,
    WITHHELD,
    clean,
    sentence,
)
from calib.uncertainty.budget import COVERAGE
from calib.uncertainty.certified import CertifiedDepth, CheckedDepth
from calib.uncertainty.conformity import Conformity, ToleranceRule, worst
from calib.uncertainty.evidence import Evidence
from calib.uncertainty.format import (
    fixed,
    percent_down,
    plain,
    upwards,
    upwards_to,
    widening,
)

UNKNOWN_COUNTRY = "ZZ"
"""User-assigned in ISO 3166-1: the manifest states no country."""

LISTED = 10
"""Outliers listed by name."""

SURPRISE = 0.0501
"""So improbable a number of errors beyond their 95 % uncertainty, one of one included, is remarked
upon and rules out a pass."""


def build_certificate(inputs: CertificateInputs) -> CertificateData:
    """Return the certificate's data."""
    failed = tuple(g for g in inputs.gates if not g.passed)
    if failed:
        inputs = replace(inputs, evidence=_without_statements(inputs.evidence))
    a, evidence, calibration = inputs.administration, inputs.evidence, inputs.calibration
    lines = tuple(depth_line(d) for d in evidence.depths)
    tolerance = evidence.tolerance
    return CertificateData(
        title=TITLE,
        subtitle=SUBTITLE,
        identifier=inputs.issue.identifier,
        issued=inputs.issue.issued,
        replaces=None if a.replaces is None else clean(a.replaces),
        amendment=None if a.replaces is None else clean(a.amendment),
        prohibition=_prohibition(tuple(clean(g.name) for g in failed)),
        cautions=_cautions(inputs),
        laboratory=clean(a.laboratory),
        address=clean(a.address),
        customer=clean(a.customer),
        item=clean(a.instrument),
        serial=clean(a.serial),
        condition=clean(a.condition),
        received=clean(a.received),
        place=clean(a.location),
        operator=clean(a.operator),
        approved_by=clean(a.approved_by),
        method=_method(calibration),
        conditions=_conditions(a),
        traceability=_traceability(calibration),
        deviations=clean(a.deviations),
        temperature_c=None if a.temperature_c is None else plain(a.temperature_c),
        humidity_percent=None if a.humidity_percent is None else plain(a.humidity_percent),
        calibrated=clean(a.date),
        performed=inputs.issue.issued if a.date is None else a.date,
        country=UNKNOWN_COUNTRY if a.country is None else a.country,
        summary=_summary(evidence, calibration),
        depths=lines,
        parameters=parameter_results(calibration),
        covariance=covariance(calibration.instrument.parameters),
        conclusion=_conclusion(
            evidence, calibrated_mm=calibration.calibrated_mm, refused=bool(failed)
        ),
        rule=NO_TOLERANCE if tolerance is None else RULES[tolerance.rule],
        tolerance=None if tolerance is None else _tolerance(tolerance),
        check_summary=_check_summary(evidence),
        length_summary=length_limit_words(evidence) or None,
        checks=tuple(_check(c) for c in listed_checks(evidence.checks)),
        lengths=tuple(length_result(e) for e in evidence.lengths),
        statements=_statements(evidence.depths, a.next_calibration),
        figure=depth_figure(
            evidence.depths, calibrated_mm=calibration.calibrated_mm, tolerance=tolerance
        ),
        annexes=annexes(inputs),
        software=tuple((clean(n), clean(v)) for n, v in inputs.provenance.software),
        dataset=clean(inputs.provenance.dataset_name),
        sha256=inputs.provenance.dataset_sha256,
        calibration_sha256=inputs.provenance.calibration_sha256,
    )


def _without_statements(evidence: Evidence) -> Evidence:
    """Return the evidence without any statement of conformity: a failed calibration makes none."""
    return replace(
        evidence,
        depths=tuple(replace(d, conformity=None) for d in evidence.depths),
        checks=tuple(replace(c, conformity=None) for c in evidence.checks),
    )


def _tolerance(tolerance: ToleranceRule) -> str:
    return f"±{plain(100 * tolerance.depth_rel)} % of depth"


def _prohibition(failed: Sequence[str]) -> str | None:
    if not failed:
        return None
    return (
        f"Not to be used: the calibration failed its check{'s' * (len(failed) > 1)} "
        f"{', '.join(failed)}. The figures below are given for diagnosis only."
    )


def _method(c: CalibrationSummary) -> str:
    model = MODELS.get(c.model, "")
    excluded = ""
    if c.outliers:
        count = len(c.outliers)
        names = ", ".join(clean(i) for i in c.outliers[:LISTED])
        more = " and others" if count > LISTED else ""
        rows = "rows disagree" if count > 1 else "row disagrees"
        excluded = f" {count} {rows} with the others ({names}{more})."
    widened = ""
    if c.noise_factor > 1:
        widened = (
            f" The stated uncertainties of a reading were widened by a factor of "
            f"{widening(c.noise_factor)}, as the residuals of the calibration ask."
        )
    return (
        f"Turning gaze plane (Xu and Wang 2017, doi 10.1177/1729881417715984), model {c.model}"
        f"{f' ({model})' if model else ''}; {c.rows} rows; {c.estimator}.{excluded}{widened}"
    )


def _conditions(a: Administration) -> str:
    if a.temperature_c is None and a.humidity_percent is None:
        return NOT_STATED
    temperature = NOT_STATED if a.temperature_c is None else f"{plain(a.temperature_c)} °C"
    humidity = NOT_STATED if a.humidity_percent is None else f"{plain(a.humidity_percent)} %"
    return f"temperature {temperature}; relative humidity {humidity}"


def _traceability(c: CalibrationSummary) -> str:
    intrinsics = "" if c.intrinsics is None else f" Intrinsics of C1: {clean(c.intrinsics)}."
    if c.reference is None:
        return f"{NOT_STATED}; the scale of depth is that of the reference depths.{intrinsics}"
    return (
        f"The scale of depth is that of the reference: {clean(c.reference)}. No traceability is "
        f"claimed beyond it.{intrinsics}"
    )


def _summary(evidence: Evidence, calibration: CalibrationSummary) -> str:
    inside = [d for d in evidence.depths if not d.extrapolated]
    if not inside:
        return "No depth could be certified within the calibrated range."
    low, high = (plain(z) for z in calibration.calibrated_mm)
    worst_percent = max(_relative(d) for d in inside)
    first, last = inside[0], inside[-1]
    return (
        f"Calibrated from {low} mm to {high} mm. At the certified depths in this range, depth is "
        f"measured to ±{upwards(100 * worst_percent)} % or better (95 %, the larger side of the "
        f"interval): ±{_half_text(first)} mm at {plain(first.result.z_mm)} mm, "
        f"±{_half_text(last)} mm at {plain(last.result.z_mm)} mm."
    )


def _half_text(d: CertifiedDepth) -> str:
    """Return the larger side of the interval, rounded up at the place of U in the table below."""
    u = d.result.standard_uncertainty_mm
    return upwards(_half(d)) if u is None else upwards_to(_half(d), uncertainty=u)


def _half(d: CertifiedDepth) -> float:
    z, interval = d.result.z_mm, d.result.interval
    return max(z - interval.low, interval.high - z)


def _relative(d: CertifiedDepth) -> float:
    return _half(d) / d.result.z_mm


def _cautions(inputs: CertificateInputs) -> tuple[str, ...]:
    evidence = inputs.evidence
    found = []
    surprise = _unexplained(evidence.checks)
    if surprise is not None:
        found.append(surprise)
    if any(d.extrapolated for d in evidence.depths):
        found.append("Depths marked as extrapolated lie outside the calibrated range.")
    found += [
        f"No uncertainty at {plain(n.depth_mm)} mm: {clean(n.reason)}."
        for n in evidence.not_certified
    ]
    warned = {j.warning for j in _inside_conformities(evidence) if j.warning is not None}
    if warned:
        found.append(
            "Tolerance / U is under 3 at some depths: there the statement of conformity depends "
            "on the uncertainty, and the risk of a wrong statement is high."
        )
    return (*found, *(sentence(clean(w)).replace("+-", "±") for w in inputs.warnings))


def _unexplained(checks: Sequence[CheckedDepth]) -> str | None:
    """Return a caution if the errors against the reference exceed their uncertainties."""
    if not checks:
        return None
    consistent = sum(c.consistent for c in checks)
    if bdtr(consistent, len(checks), COVERAGE) >= SURPRISE:
        return None
    return (
        f"Against the independent reference only {consistent} of {len(checks)} errors lie within "
        "their 95 % uncertainty: the model, the calibration's reference or the independent one "
        "has errors that the stated uncertainty does not hold."
    )


def _inside_conformities(evidence: Evidence) -> list[Conformity]:
    certified = [d.conformity for d in evidence.depths if not d.extrapolated]
    checked = [c.conformity for c in evidence.checks if not c.extrapolated]
    return [c for c in (*certified, *checked) if c is not None]


def _conclusion(
    evidence: Evidence, *, calibrated_mm: tuple[float, float], refused: bool
) -> Conclusion:
    if evidence.tolerance is None:
        return Conclusion(None, NO_TOLERANCE, "")
    if refused:
        return Conclusion(None, WITHHELD, "")
    found = _inside_conformities(evidence)
    low, high = calibrated_mm
    missing = any(low <= n.depth_mm <= high for n in evidence.not_certified)
    if not found or missing:
        return Conclusion(None, "No statement of conformity can be made for the whole range.", "")
    verdict = worst(c.verdict for c in found)
    limited = ""
    if verdict == "pass" and _unexplained(evidence.checks) is not None:
        verdict = "conditionalPass"
        limited = " No better statement is made, because an independent reference contradicts it."
    depths = sum(not d.extrapolated for d in evidence.depths)
    checks = sum(not c.extrapolated for c in evidence.checks)
    independent = f" and {checks} independent check{'s' * (checks != 1)}" if checks else ""
    lowest = min(c.probability for c in found)
    return Conclusion(
        verdict=verdict,
        words=f"Conformity over the calibrated range: {VERDICTS[verdict]}",
        basis=(
            f"The worst of {depths} certified depth{'s' * (depths != 1)}{independent} decides; the "
            f"lowest probability of conformance is {percent_down(lowest)} %.{limited}"
        ),
    )


def _check(c: CheckedDepth) -> tuple[Result, Judgement | None]:
    return check_error(c), None if c.conformity is None else judgement(c.conformity)


def _check_summary(evidence: Evidence) -> str | None:
    if not evidence.checks:
        return None
    inside = [c for c in evidence.checks if not c.extrapolated]
    beyond = [c for c in evidence.checks if c.extrapolated]
    parts = [f"Independent reference: {clean(evidence.check_reference)}."]
    parts += [_errors("Within the calibrated range", inside)] if inside else []
    parts += [_errors("Beyond it (extrapolated)", beyond)] if beyond else []
    if len(evidence.checks) > LISTED_CHECKS:
        parts.append(
            f"Listed are the {LISTED_CHECKS} points whose errors are largest against their "
            f"uncertainties; all {len(evidence.checks)} are in calibration.json."
        )
    return " ".join(parts)


def _errors(where: str, checks: Sequence[CheckedDepth]) -> str:
    relative = [c.z_mm / c.reference_mm - 1 for c in checks]
    rms = (sum(e * e for e in relative) / len(relative)) ** 0.5
    largest = max(relative, key=abs)
    consistent = sum(c.consistent for c in checks)
    return (
        f"{where}: {len(checks)} point{'s' * (len(checks) != 1)}, relative error "
        f"{fixed(100 * rms, 2)} % rms, {fixed(100 * largest, 2)} % at most; {consistent} within "
        "their 95 % uncertainty."
    )


def _statements(
    depths: Sequence[CertifiedDepth], next_calibration: str | None
) -> tuple[CertificateField, ...]:
    meanings = []
    if any(d.result.linear_valid for d in depths):
        meanings.append(LINEAR_MEANING)
    if any(not d.result.linear_valid for d in depths):
        meanings.append(MONTE_CARLO_MEANING)
    # Only where the customer wants one: ISO/IEC 17025:2017, 7.8.4.3.
    date = (
        ()
        if next_calibration is None
        else (CertificateField(NEXT_CALIBRATION, clean(next_calibration)),)
    )
    return (
        CertificateField("Uncertainty", " ".join([ONE_READING, *meanings])),
        CertificateField("Validity", f"{RELATES} {STABILITY} {ADJUSTMENT}"),
        *date,
        CertificateField("Reproduction", REPRODUCTION),
        CertificateField("Accreditation", NO_ACCREDITATION),
    )
