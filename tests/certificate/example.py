"""A small calibration with everything a certificate can show; figures of no rig."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np

from calib.certificate.inputs import (
    Administration,
    CalibrationSummary,
    CertificateInputs,
    CertificateProvenance,
    DerivedQuantity,
    Issue,
)
from calib.core.gate import Gate
from calib.uncertainty.certified import CertifiedDepth, certify_depths, check_depth
from calib.uncertainty.conformity import ToleranceRule, assess, measured_conformity
from calib.uncertainty.depth import reading_at
from calib.uncertainty.evidence import Evidence, NotCertified
from calib.uncertainty.lengths import Length, length_errors, length_limit
from calib.uncertainty.measurement import (
    Instrument,
    ParameterKnowledge,
    Reading,
    ReadingSpread,
    SharedErrors,
    Spread,
)
from calib.uncertainty.montecarlo import Interval

CALIBRATED_MM = (485.9, 1008.5)
NAMES = ("baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm")
VALUES = np.array([76.9, 0.0131, -21.0, 1.2])
ROOT = np.array([[9.0, 0, 0, 0], [-1e-5, 1.5e-4, 0, 0], [0.2, 0.3, 0.8, 0], [-9.0, 0, 0.1, 0.1]])
READING = ReadingSpread(
    x1c=Spread(normal=1.5e-4),
    y1c=Spread(normal=1.5e-4),
    alpha2_rad=Spread(width=math.radians(0.05625)),
)

TOLERANCE = ToleranceRule(0.02, "guard-band")

STATED = Administration(
    laboratory="Institute of Automation, Vision Laboratory",
    address="95 Zhongguancun East Road, Beijing 100190",
    customer="Sheet Metal Works Ltd, Dr. Example",
    instrument="Active-gazing stereo rig AG-2",
    serial="AG2-0017",
    condition="complete, clean, without damage",
    location="Laboratory, room 214",
    date="2026-01-31",
    operator="A. Operator",
    approved_by="Dr. B. Approver",
    temperature_c=21.3,
    humidity_percent=45.0,
    deviations="none",
    country="CN",
)

HOSTILE = (
    "<script>alert('x')</script> \"quoted\" & ]]> {{ 7 * 7 }} "
    "\u202egnp.exe\u202c \x07\ud800\ufffe שלום " + "W" * 300
)


def endless() -> CertificateInputs:
    """The hostile manifest with words that have no end in place of the attacks."""
    return hostile("x" * 300)


def hostile(text: str = HOSTILE) -> CertificateInputs:
    """A manifest, gates and names that attack every form."""
    plain = inputs()
    administration = Administration(
        **{
            name: text
            for name, value in vars(STATED).items()
            if isinstance(value, str | None) and name not in ("date", "received", "country")
        }
    )
    checks = tuple(replace(c, name=text) for c in plain.evidence.checks)
    lengths = tuple(replace(e, name=text) for e in plain.evidence.lengths)
    evidence = replace(
        plain.evidence,
        checks=checks,
        lengths=lengths,
        check_reference=text,
        not_certified=(NotCertified(3000.0, text),),
    )
    return replace(
        plain,
        administration=administration,
        provenance=replace(
            plain.provenance,
            dataset_name=text,
            dataset_title=text,
            citation=text,
            commit=text,
        ),
        calibration=replace(plain.calibration, reference=text, outliers=(text,), intrinsics=text),
        evidence=evidence,
        gates=(Gate(text, True, text),),
        warnings=(text,),
    )


def instrument(*, posterior: bool) -> Instrument:
    covariance = ROOT @ ROOT.T
    draws = None
    if posterior:
        rng = np.random.default_rng(1)
        draws = rng.multivariate_normal(VALUES, covariance, 16_000, method="eigh")
    knowledge = ParameterKnowledge(
        names=NAMES,
        values=VALUES,
        covariance=covariance,
        degrees_of_freedom=None if posterior else 22.0,
        evaluation=("A, B", "A", "A", "B"),
        draws=draws,
    )
    return Instrument(knowledge, READING)


def with_cameras() -> CertificateInputs:
    """One calibration of which intrinsics and pose were estimated from images."""
    plain = inputs()
    by_shared = np.array([[2.0, 0.5, 1.0], [1e-5, 2e-5, 3e-5], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])
    rig = instrument(posterior=False)
    shared = SharedErrors(
        ("intrinsics of C1", "pose of C2 (stereo reference)", "intrinsics of C1"), by_shared
    )
    rig = replace(rig, shared=shared)
    loading = np.zeros((4, 3))
    loading[0] = 1e-3, 0.0, 5e-4
    depths = tuple(
        _certify(rig, [replace(_ray(rig, z), shared=loading)], i, TOLERANCE)
        for i, z in enumerate((490, 740, 1000))
    )
    return replace(
        plain,
        calibration=replace(plain.calibration, instrument=rig),
        evidence=replace(plain.evidence, depths=depths),
    )


def _ray(rig: Instrument, z_mm: float) -> Reading:
    return reading_at(rig.theta, z_mm=z_mm, x1c=0.1)


def _certify(
    rig: Instrument, rays: list[Reading], seed: int, tolerance: ToleranceRule | None
) -> CertifiedDepth:
    (found,) = certify_depths(
        rig,
        [rays],
        np.random.default_rng(seed),
        calibrated_mm=CALIBRATED_MM,
        tolerance=tolerance,
    )
    assert isinstance(found, CertifiedDepth)
    return found


def certified(
    rig: Instrument, depths: tuple[float, ...], tolerance: ToleranceRule | None
) -> tuple[CertifiedDepth, ...]:
    return tuple(
        _certify(
            rig,
            [reading_at(rig.theta, z_mm=z, x1c=x, y1c=0.05) for x in (-0.05, 0.1, 0.26)],
            i,
            tolerance,
        )
        for i, z in enumerate(depths)
    )


def evidence(posterior: bool, tolerance: ToleranceRule | None) -> Evidence:
    """Return the evidence, computed once, under any tolerance."""
    found = _evidence(posterior)
    if tolerance == TOLERANCE:
        return found
    depths = tuple(
        replace(
            d,
            conformity=tolerance
            and assess(
                error_mm=0.0,
                standard_uncertainty_mm=d.conformity.standard_uncertainty_mm,
                expanded_uncertainty_mm=d.conformity.expanded_uncertainty_mm,
                limit_mm=tolerance.depth_rel * d.result.z_mm,
                rule=tolerance.rule,
            ),
        )
        for d in found.depths
        if d.conformity is not None
    )
    checks = tuple(
        replace(
            c,
            conformity=tolerance
            and measured_conformity(
                z_mm=c.z_mm,
                u_mm=c.u_mm,
                low95_mm=c.low95_mm,
                high95_mm=c.high95_mm,
                reference_mm=c.reference_mm,
                u_reference_mm=c.u_reference_mm,
                tolerance=tolerance,
            ),
        )
        for c in found.checks
    )
    return replace(found, depths=depths, checks=checks, tolerance=tolerance)


@cache
def _evidence(posterior: bool) -> Evidence:
    rig, tolerance = instrument(posterior=posterior), TOLERANCE
    checks = tuple(
        check_depth(
            name=name,
            reference_mm=reference,
            u_reference_mm=1.0,
            z_mm=z,
            u_mm=u,
            low95_mm=z - 1.9 * u,
            high95_mm=z + 2.1 * u,
            calibrated_mm=CALIBRATED_MM,
            tolerance=tolerance,
        )
        for name, reference, z, u in (
            ("2-1", 1020.0, 1029.1, 5.6),
            ("2-2", 1000.0, 1007.4, 5.5),
            ("3-1", 1620.0, 1649.9, 14.2),
            ("4-1", 2120.0, 2192.0, math.inf),
        )
    )
    checks = (*checks[:-1], replace(checks[-1], low95_mm=1980.0, high95_mm=math.inf))
    lengths = tuple(
        length_errors(
            rig,
            [
                Length(
                    name,
                    start=reading_at(rig.theta, z_mm=near, x1c=-0.2),
                    end=reading_at(rig.theta, z_mm=far, x1c=0.3),
                    reference_mm=reference,
                    u_reference_mm=0.5,
                )
            ],
            np.random.default_rng(3),
        )[0]
        for name, near, far, reference in (
            ("plate 2", 900.0, 950.0, 470.0),
            ("plate 3", 700.0, 720.0, 357.5),
        )
    )
    return Evidence(
        depths=certified(rig, (490, 740, 1000, 1500), tolerance),
        checks=checks,
        check_reference="ruler",
        lengths=lengths,
        length_limit=length_limit(lengths),
        tolerance=tolerance,
    )


def _interval(p: ParameterKnowledge, both: np.ndarray) -> Interval | None:
    if p.draws is None:
        return None
    low, high = np.quantile(p.draws @ both, [0.025, 0.975])
    return Interval(float(low), float(high))


def inputs(
    *,
    administration: Administration = STATED,
    posterior: bool = True,
    tolerance: ToleranceRule | None = TOLERANCE,
) -> CertificateInputs:
    rig = instrument(posterior=posterior)
    p = rig.parameters
    both = np.array([1, 0, 0, 1])
    return CertificateInputs(
        administration=administration,
        issue=Issue("AG-20260201T093012Z-3F2A9C1B-8D1E22C4A7F0", "2026-02-01"),
        provenance=CertificateProvenance(
            dataset_name="example",
            dataset_title="Example of a certificate",
            dataset_sha256="3f2a9c1b" + "0" * 56,
            calibration_sha256="c0ffee00" + "1" * 56,
            citation="Xu and Wang 2017",
            seed=1,
            software=(("calib", "0.1.0"), ("numpy", "2.4.6")),
            commit="0123abc",
        ),
        calibration=CalibrationSummary(
            model="axis-offset",
            instrument=rig,
            identified_by=("both", "data", "data", "prior"),
            estimator="posterior by emcee" if posterior else "least squares",
            rows=26,
            outliers=("7",),
            reference="stereovision",
            calibrated_mm=CALIBRATED_MM,
            noise_factor=1.31,
            derived=(
                DerivedQuantity(
                    "L_b + e",
                    "baseline seen at 90°",
                    "mm",
                    float(both @ p.values),
                    float(np.sqrt(both @ p.covariance @ both)),
                    _interval(p, both),
                ),
            ),
            intrinsics="given in the dataset",
        ),
        evidence=evidence(posterior, tolerance),
        gates=(
            Gate("convergence", True, "R-hat 1.002, 4300 effective draws"),
            Gate("agreement", True, "importance sampling agrees, k-hat 0.31"),
        ),
        warnings=(),
    )
