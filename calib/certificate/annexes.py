"""The annexes: everything that stands behind the two pages."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.certificate.budgets import budgets
from calib.certificate.data import NONE, Annex, AnnexTable
from calib.certificate.inputs import CalibrationSummary, CertificateInputs, CertificateProvenance
from calib.certificate.numbers import (
    check_error,
    covariance,
    depth_line,
    length_result,
    listed_checks,
)
from calib.core.gate import Gate
from calib.core.unit_diagonal import unit_diagonal
from calib.geometry.parameters import INDEX, PARAMETERS
from calib.results.wording import EXTRAPOLATED, LENGTHS_NOTE, VERDICTS, clean
from calib.rows.observations import GROUP_SOURCE
from calib.uncertainty.certified import CertifiedDepth, CheckedDepth
from calib.uncertainty.depth import DepthUncertainty
from calib.uncertainty.evidence import Evidence
from calib.uncertainty.format import (
    SHOWN,
    Rounded,
    at_place,
    fixed,
    interval,
    last_place,
    percent_down,
    plain,
    significant,
    upwards,
    with_uncertainty,
)
from calib.uncertainty.lengths import LengthError
from calib.uncertainty.measurement import ParameterKnowledge


def annexes(inputs: CertificateInputs) -> tuple[Annex, ...]:
    """Return all annexes that the data have something for."""
    evidence, calibration = inputs.evidence, inputs.calibration
    shared = calibration.instrument.shared
    found = [
        budgets(
            evidence.depths,
            mean_gaze_rad=calibration.instrument.mean_gaze_rad,
            cameras=shared is not None and shared.of_readings > 0,
            groups=shared is not None and GROUP_SOURCE in shared.names,
        ),
        _monte_carlo(evidence.depths),
        _positions(evidence.depths),
        _checks(evidence),
        _lengths(evidence),
        _correlations(calibration),
        _provenance(inputs.provenance, inputs.gates),
    ]
    return tuple(annex for annex in found if annex is not None)


def _monte_carlo(depths: Sequence[CertifiedDepth]) -> Annex | None:
    if not depths:
        return None
    return Annex(
        title="Monte Carlo and validation of the first-order law",
        introduction=(
            "JCGM 101, adaptive procedure (7.9) to two significant digits of u. Clause 8: the "
            "linear interval is validated if its ends differ from those of the symmetric Monte "
            "Carlo interval by no more than the numerical tolerance δ. Where the budget gives no "
            "k, the comparison is made with 1.96, and the linear interval is not stated."
        ),
        tables=(
            AnnexTable(
                title="Distribution of the measured depth and its 95 % intervals, mm",
                columns=(
                    "Depth", "Mean", "u", "Symmetric", "Shortest", "Linear",
                    "Difference of ends", "δ", "Valid", "Trials", "Ends known to",
                ),
                rows=tuple(_monte_carlo_row(d.result) for d in depths),
                note=_numerical_note(depths),
                words=(8,),
            ),
        ),
    )  # fmt: skip


def _monte_carlo_row(r: DepthUncertainty) -> tuple[str, ...]:
    mc, v = r.monte_carlo, r.validation
    u = mc.standard_uncertainty
    place = u if u is not None else mc.tolerance * 20

    def ends(low: float, high: float) -> str:
        return "{} to {}".format(*interval(low, high, uncertainty=place))

    return (
        at_place(r.z_mm, uncertainty=place),
        NONE if mc.estimate is None else at_place(mc.estimate, uncertainty=place),
        NONE if u is None else with_uncertainty(0.0, u).uncertainty,
        ends(mc.symmetric.low, mc.symmetric.high),
        ends(mc.shortest.low, mc.shortest.high),
        ends(v.linear.low, v.linear.high),
        f"{significant(v.difference_low, digits=2)}, {significant(v.difference_high, digits=2)}",
        significant(v.tolerance, digits=1),
        "yes" if v.validated else "no",
        f"{mc.trials:,}".replace(",", "\u202f"),
        f"±{significant(max(mc.numerical_low, mc.numerical_high), digits=2)}",
    )


def _numerical_note(depths: Sequence[CertifiedDepth]) -> str:
    notes = []
    if any(not d.result.monte_carlo.stable for d in depths):
        notes.append("The number of trials did not suffice everywhere: see the last column.")
    if any(d.result.monte_carlo.limited_by_draws for d in depths):
        notes.append(
            "The ends are known less well than δ because the posterior has a finite number of "
            "independent draws; more trials would not help."
        )
    return " ".join(notes)


def _positions(depths: Sequence[CertifiedDepth]) -> Annex | None:
    if not depths:
        return None
    rows = []
    for line in (depth_line(d) for d in depths):
        g = line.region
        rows.append(
            (
                ", ".join(g.position),
                ", ".join(g.uncertainty),
                ", ".join(g.correlation),
                g.coverage_factor,
                ", ".join(g.semi_axes),
                "({})".format(", ".join(g.longest_axis)),
            )
        )
    return Annex(
        title="Position",
        introduction=(
            "JCGM 102. Frame of the monitor camera C1: X right, Y down, Z forward, origin at its "
            "optical centre. The ellipsoid has the shape of the covariance and holds 95 % of the "
            "Monte Carlo trials; a normal distribution would have k = 2.80."
        ),
        tables=(
            AnnexTable(
                title="Position with its 95 % ellipsoid",
                columns=(
                    "x, y, z / mm", "u(x), u(y), u(z) / mm", "r(x,y), r(x,z), r(y,z)", "k",
                    "Semi-axes / mm", "Direction of the longest",
                ),
                rows=tuple(rows),
                words=(),
            ),
        ),
    )  # fmt: skip


def _checks(evidence: Evidence) -> Annex | None:
    if not evidence.checks:
        return None
    listed = listed_checks(evidence.checks)
    judged = any(c.conformity is not None for c in listed)
    columns = [
        "Point", "Reference / mm", "Measured / mm", "95 % interval / mm", "Error / mm", "U / mm",
        "k", "Error / %", *(["Conformance / %"] if judged else []), "Statement",
    ]  # fmt: skip
    some = f" The {len(listed)} worst are listed." if len(listed) < len(evidence.checks) else ""
    return Annex(
        title="Independent check",
        introduction=(
            f"Reference: {clean(evidence.check_reference)}. None of these points took part in the "
            "calibration. U is the 95 % uncertainty of the error, that of the reference included, "
            "by the larger side of the interval; k = U / u."
            f"{some}"
        ),
        tables=(
            AnnexTable(
                title="Measured against reference depth",
                columns=tuple(columns),
                rows=tuple(_check_row(c, judged=judged) for c in listed),
                words=(0, len(columns) - 1),
            ),
        ),
    )


def _check_row(c: CheckedDepth, *, judged: bool) -> tuple[str, ...]:
    error = check_error(c)
    finite = math.isfinite(c.high95_mm)
    half = max(c.z_mm - c.low95_mm, c.high95_mm - c.z_mm) if finite else c.z_mm - c.low95_mm
    place = half / 2 if half > 0 else 1.0
    low, high = interval(c.low95_mm, c.high95_mm if finite else c.z_mm, uncertainty=place)
    statement = NONE if c.conformity is None else VERDICTS[c.conformity.verdict]
    if c.extrapolated:
        statement = EXTRAPOLATED if c.conformity is None else f"{statement} ({EXTRAPOLATED})"
    return (
        clean(c.name),
        plain(c.reference_mm),
        at_place(c.z_mm, uncertainty=place),
        f"{low} to {high if finite else '∞'}",
        error.value,
        error.expanded_uncertainty or "∞",
        error.coverage_factor or NONE,
        fixed(100 * (c.z_mm / c.reference_mm - 1), _percent_places(c)),
        *([NONE if c.conformity is None else percent_down(c.conformity.probability)] * judged),
        statement,
    )


def _percent_places(c: CheckedDepth) -> int:
    """Return the decimals of an error in per cent: two, or more where its u is smaller."""
    u = math.hypot(c.u_mm, c.u_reference_mm) if math.isfinite(c.u_mm) else 0.0
    return max(2, -last_place(100 * u / c.reference_mm)) if u > 0 else 2


def _lengths(evidence: Evidence) -> Annex | None:
    if not evidence.lengths:
        return None
    return Annex(
        title="Lengths",
        introduction=LENGTHS_NOTE,
        tables=(
            AnnexTable(
                title="Measured against reference lengths",
                columns=("Length", "Reference / mm", "Measured / mm", "Error / mm", "U / mm", "k"),
                rows=tuple(_length_row(e) for e in evidence.lengths),
                note=length_limit_words(evidence),
            ),
        ),
    )


def _length_row(e: LengthError) -> tuple[str, ...]:
    error = length_result(e)
    return (
        error.name,
        plain(e.reference_mm),
        at_place(e.measured_mm, uncertainty=e.standard_uncertainty_mm),
        error.value,
        error.expanded_uncertainty or NONE,
        error.coverage_factor or NONE,
    )


def length_limit_words(evidence: Evidence) -> str:
    """Return the limit A + K L in words; empty without one."""
    limit = evidence.length_limit
    if limit is None:
        return ""
    return (
        f"Limit of the error of length: {_bound(limit.constant_mm)} mm + "
        f"{_bound(limit.slope)} L for L from {plain(limit.shortest_mm)} mm to "
        f"{plain(limit.longest_mm)} mm ({limit.count} "
        f"length{'s' if limit.count > 1 else ''})."
    )


def _bound(number: float) -> str:
    return upwards(number) if number > 0 else "0"


def _correlations(calibration: CalibrationSummary) -> Annex:
    p = calibration.instrument.parameters
    r = unit_diagonal(p.covariance)[1]
    symbols = tuple(PARAMETERS[INDEX[name]].symbol for name in p.names)
    rows = tuple(
        (symbols[i], *(fixed(float(r[i, j]), 5) for j in range(len(symbols))))
        for i in range(len(symbols))
    )
    m = covariance(p)
    covered = tuple(
        (symbol, *(_mantissa(cell) for cell in row))
        for symbol, row in zip(symbols, m.rows, strict=True)
    )
    units = ", ".join(f"{s} in {u}" for s, u in zip(symbols, m.units, strict=True))
    return Annex(
        title="Parameters: estimates and covariance",
        introduction=(
            "Parameters of one calibration must be used together: with their standard "
            "uncertainties alone a depth would come out with an uncertainty far too large or far "
            "too small. The digital certificate has the covariance with ten digits."
        ),
        tables=(
            *_covariance(p, symbols, covered, note=units),
            AnnexTable(title="Correlation coefficients", columns=("", *symbols), rows=rows),
        ),
    )


COLUMNS = 6
"""Covariances that a page shows side by side, with seven digits each."""


def _covariance(
    p: ParameterKnowledge,
    symbols: Sequence[str],
    covered: Sequence[Sequence[str]],
    *,
    note: str,
) -> tuple[AnnexTable, ...]:
    """Return estimates and covariance, in as many tables as their columns need."""
    title, heads = "Estimate, standard uncertainty and covariance", ("", "Estimate", "u")
    stated = [(both.value, both.uncertainty) for both in _estimates(p)]
    note = f"{note}; covariances in the products of these units."
    if len(symbols) <= COLUMNS:
        rows = tuple(
            (head, *own, *cells) for (head, *cells), own in zip(covered, stated, strict=True)
        )
        return (AnnexTable(title=title, columns=(*heads, *symbols), rows=rows, note=note),)
    first = tuple((head, *own) for (head, *_), own in zip(covered, stated, strict=True))
    tables = [AnnexTable(title="Estimate and standard uncertainty", columns=heads, rows=first)]
    for start in range(0, len(symbols), COLUMNS):
        end = min(start + COLUMNS, len(symbols))
        tables.append(
            AnnexTable(
                title=f"Covariance, columns {symbols[start]} to {symbols[end - 1]}",
                columns=("", *symbols[start:end]),
                rows=tuple((head, *cells[start:end]) for head, *cells in covered),
                note=note if end == len(symbols) else "",
            )
        )
    return tuple(tables)


def _estimates(p: ParameterKnowledge) -> list[Rounded]:
    scale = [SHOWN[PARAMETERS[INDEX[name]].unit].factor for name in p.names]
    u = np.sqrt(np.diag(p.covariance))
    return [
        with_uncertainty(float(f * v), float(f * s))
        for f, v, s in zip(scale, p.values, u, strict=True)
    ]


def _mantissa(cell: str) -> str:
    """Return a covariance with seven digits, which keep the matrix positive definite."""
    return f"{float(cell):.6e}"


def _provenance(p: CertificateProvenance, gates: Sequence[Gate]) -> Annex:
    facts = [
        ("Dataset", f"{clean(p.dataset_title)} ({clean(p.dataset_name)})"),
        ("Source of the data", clean(p.citation)),
        ("SHA-256 of the dataset", p.dataset_sha256),
        ("SHA-256 of calibration.json, which is certified", p.calibration_sha256),
        ("Seed of the random numbers", str(p.seed)),
        ("Software", ", ".join(f"{clean(name)} {clean(version)}" for name, version in p.software)),
        ("Commit", clean(p.commit)),
    ]
    checks = tuple(
        (clean(g.name), "passed" if g.passed else "FAILED", clean(g.detail)) for g in gates
    )
    tables = [
        AnnexTable(title="Data and software", columns=("", ""), rows=tuple(facts), words=(0, 1))
    ]
    if checks:
        tables.append(
            AnnexTable(
                title="Checks of the calibration",
                columns=("Check", "Outcome", "Detail"),
                rows=checks,
                words=(0, 1, 2),
            )
        )
    return Annex(
        title="Data, software and checks",
        introduction="Equal dataset, seed and versions give equal results.",
        tables=tuple(tables),
    )
