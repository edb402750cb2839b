"""Results as the certificate prints them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.certificate.budget_lines import budget_lines, symbol
from calib.certificate.data import CertificateField, DepthLine, Judgement, Matrix, Region, Result
from calib.certificate.inputs import CalibrationSummary
from calib.geometry.parameters import INDEX, PARAMETERS
from calib.results.wording import VERDICTS, clean
from calib.uncertainty.budget import coverage_factor
from calib.uncertainty.certified import CertifiedDepth, CheckedDepth
from calib.uncertainty.conformity import Conformity
from calib.uncertainty.depth import PositionUncertainty
from calib.uncertainty.format import (
    SHOWN,
    at_place,
    fixed,
    interval,
    percent_down,
    plain,
    significant,
    upwards,
    upwards_to,
    with_uncertainty,
)
from calib.uncertainty.lengths import LengthError
from calib.uncertainty.measurement import ParameterKnowledge
from calib.uncertainty.montecarlo import NORMAL_FACTOR, Interval, shortest_interval

COVARIANCE_DIGITS = 9
"""Decimals of the mantissa of a covariance: baseline and eccentricity correlate to -0.9997 and
beyond, and a program that reads the matrix must be able to invert it."""

LISTED_CHECKS = 200
"""Independent checks that are printed, six pages: nobody reads more, and files with all of 100,000
would be of no use. Summary and statements of conformity are of all."""

DECIDED = {
    "data": "identified by the data",
    "prior": "identified by prior knowledge",
    "both": "identified by data and prior knowledge together",
}


def result(
    *,
    name: str,
    meaning: str,
    unit: str,
    value: float,
    u: float | None,
    factor: float | None,
    stated: Interval | None,
    remark: str,
) -> Result:
    """Return a number with its uncertainty, in printed units.

    Parameters
    ----------
    unit
        "mm", "rad" or "1"; of `value`, `u` and `stated`.
    u
        None where none exists.
    factor
        None where no coverage factor is valid; else the interval is value ± factor u.
    stated
        95 % interval; None if none is stated. Where there is no `factor` it is the one printed;
        U is then half of it, rounded up, and k = U / u.
    """
    scale = SHOWN[unit].factor
    value *= scale
    u = None if u is None else u * scale
    if factor is not None and u is not None:
        shown, k = at_place(value, uncertainty=u), fixed(factor, 2)
        expanded = upwards_to(factor * u, uncertainty=u)
        ends = interval(value - factor * u, value + factor * u, uncertainty=u)
        low: str | None = ends[0]
        high: str | None = ends[1]
    else:
        width = None if stated is None else (stated.high - stated.low) / (2 * NORMAL_FACTOR)
        place = u if u is not None else (width or 1.0) * scale
        shown, expanded, k = at_place(value, uncertainty=place), None, None
        low = high = None
        if stated is not None:
            low, high = interval(stated.low * scale, stated.high * scale, uncertainty=place)
            half = (stated.high - stated.low) * scale / 2
            expanded = upwards_to(half, uncertainty=place)
            k = None if u is None else fixed(half / u, 2)
    return Result(
        name=name,
        meaning=meaning,
        unit=SHOWN[unit].unit,
        value=shown,
        standard_uncertainty=None if u is None else with_uncertainty(0.0, u).uncertainty,
        expanded_uncertainty=expanded,
        coverage_factor=k,
        from_interval=factor is None or u is None,
        low=low,
        high=high,
        remark=remark,
    )


def depth_line(certified: CertifiedDepth) -> DepthLine:
    """Return a certified depth."""
    r = certified.result
    z = r.z_mm
    half = max(z - r.interval.low, r.interval.high - z)
    return DepthLine(
        depth=result(
            name="depth z",
            meaning="depth in the frame of the monitor camera",
            unit="mm",
            value=z,
            u=r.standard_uncertainty_mm,
            factor=r.budget.coverage_factor if r.linear_valid else None,
            stated=r.interval,
            remark="JCGM 100, validated" if r.linear_valid else "Monte Carlo",
        ),
        ray=fixed(r.x1c, 3),
        relative=upwards(100 * half / z),
        judgement=None if certified.conformity is None else judgement(certified.conformity),
        extrapolated=certified.extrapolated,
        region=_region(certified.position),
        contributions=tuple(
            CertificateField(
                symbol(name), at_place(part, uncertainty=r.budget.standard_uncertainty / 10)
            )
            for name, part in r.budget.sources
        ),
        budget=budget_lines(r.budget),
    )


def judgement(c: Conformity) -> Judgement:
    """Return a statement of conformity."""
    return Judgement(
        limit=significant(c.limit_mm),
        probability=percent_down(c.probability),
        ratio=fixed(math.floor(10 * c.ratio) / 10, 1),
        verdict=c.verdict,
        words=VERDICTS[c.verdict],
        warning=c.warning,
    )


def _region(p: PositionUncertainty) -> Region:
    u = p.standard_uncertainty_mm
    pairs = [
        with_uncertainty(float(x), float(s)) if s > 0 else None
        for x, s in zip(p.position_mm, u, strict=True)
    ]
    place = [fixed(float(x), 3) for x in p.position_mm]
    r = p.correlation
    axis = p.directions[:, 0] * np.sign(p.directions[np.argmax(np.abs(p.directions[:, 0])), 0])
    x, y, z = (a.value if a else b for a, b in zip(pairs, place, strict=True))
    ux, uy, uz = (a.uncertainty if a else "0" for a in pairs)
    first, second, third = (significant(float(s)) for s in p.semi_axes_mm)
    dx, dy, dz = (fixed(float(d), 3) for d in axis)
    return Region(
        position=(x, y, z),
        uncertainty=(ux, uy, uz),
        correlation=(fixed(r[0, 1], 3), fixed(r[0, 2], 3), fixed(r[1, 2], 3)),
        covariance=tuple(
            tuple(f"{c:.{COVARIANCE_DIGITS}e}" for c in row) for row in p.covariance_mm2.tolist()
        ),
        coverage_factor=fixed(p.coverage_factor, 2),
        semi_axes=(first, second, third),
        longest_axis=(dx, dy, dz),
    )


def parameter_results(calibration: CalibrationSummary) -> tuple[Result, ...]:
    """Return the parameters and what follows from them."""
    p = calibration.instrument.parameters
    found = []
    for i, name in enumerate(p.names):
        entry = PARAMETERS[INDEX[name]]
        found.append(
            result(
                name=entry.symbol,
                meaning=entry.meaning,
                unit=entry.unit,
                value=float(p.values[i]),
                u=math.sqrt(float(p.covariance[i, i])),
                factor=_factor(p),
                stated=None if p.draws is None else shortest_interval(np.sort(p.draws[:, i])),
                remark=DECIDED[calibration.identified_by[i]],
            )
        )
    found += [
        result(
            name=d.name,
            meaning=d.meaning,
            unit=d.unit,
            value=d.value,
            u=d.std,
            factor=_factor(p),
            stated=d.interval,
            remark="derived" if d.interval is None else "derived; equal tails",
        )
        for d in calibration.derived
    ]
    return tuple(found)


def _factor(p: ParameterKnowledge) -> float | None:
    """Return the coverage factor of parameters that have no draws: those are taken as normal."""
    if p.draws is not None:
        return None
    return NORMAL_FACTOR if p.degrees_of_freedom is None else coverage_factor(p.degrees_of_freedom)


def covariance(p: ParameterKnowledge) -> Matrix:
    """Return the covariance of the parameters in printed units."""
    shown = [SHOWN[PARAMETERS[INDEX[name]].unit] for name in p.names]
    scale = np.array([s.factor for s in shown])
    scaled = p.covariance * np.outer(scale, scale)
    return Matrix(
        names=p.names,
        units=tuple(s.unit for s in shown),
        rows=tuple(tuple(f"{c:.{COVARIANCE_DIGITS}e}" for c in row) for row in scaled.tolist()),
    )


def listed_checks(checks: Sequence[CheckedDepth]) -> tuple[CheckedDepth, ...]:
    """Return the checks to list: the `LISTED_CHECKS` with the worst errors, in their order."""
    if len(checks) <= LISTED_CHECKS:
        return tuple(checks)
    excess = [abs(c.z_mm - c.reference_mm) / max(c.allowed_mm, 1e-9) for c in checks]
    worst = sorted(range(len(checks)), key=lambda i: excess[i], reverse=True)[:LISTED_CHECKS]
    return tuple(checks[i] for i in sorted(worst))


def check_error(check: CheckedDepth) -> Result:
    """Return the error of a checked depth."""
    half = max(check.z_mm - check.low95_mm, check.high95_mm - check.z_mm)
    expanded = math.hypot(half, NORMAL_FACTOR * check.u_reference_mm)
    return _error(
        name=clean(check.name),
        meaning=f"error at a reference depth of {plain(check.reference_mm)} mm",
        error=check.z_mm - check.reference_mm,
        u=math.hypot(check.u_mm, check.u_reference_mm),
        expanded=expanded,
    )


def length_result(e: LengthError) -> Result:
    """Return the error of a length."""
    return _error(
        name=clean(e.name),
        meaning=f"error at a reference length of {plain(e.reference_mm)} mm",
        error=e.error_mm,
        u=e.standard_uncertainty_mm,
        expanded=e.expanded_uncertainty_mm,
    )


def _error(*, name: str, meaning: str, error: float, u: float, expanded: float) -> Result:
    finite = math.isfinite(expanded)
    return result(
        name=name,
        meaning=meaning,
        unit="mm",
        value=error,
        u=u if math.isfinite(u) else None,
        factor=None,
        stated=Interval(error - expanded, error + expanded) if finite else None,
        remark="95 % interval of the error, reference included",
    )
