"""Evidence: simulated rig; agreement with the parts tested on their own."""

from __future__ import annotations

from dataclasses import replace

import example
import numpy as np
import pytest
from numpy.random import SeedSequence

from calib.certificate.annexes import COLUMNS, _correlations
from calib.dataset.tables import LengthTable
from calib.geometry.camera import Camera
from calib.geometry.parameters import PARAMETERS
from calib.geometry.plane import gaze_at
from calib.instrument.calibrated import CalibratedInstrument
from calib.instrument.evidence import gather_evidence
from calib.instrument.validation import ValidationResult
from calib.rows.common_errors import CommonErrors
from calib.rows.from_table import CameraSet, RowSettings, Setup, ValidationRows
from calib.rows.observations import Observations
from calib.stages.serialise import deserialise, serialise
from calib.uncertainty.evidence import Evidence
from calib.uncertainty.format import SHOWN
from calib.uncertainty.measurement import Instrument, ParameterKnowledge, SharedErrors
from calib.uncertainty.predictive import DepthPrediction


def _rows(points: np.ndarray, *, shared: bool) -> Observations:
    gaze = gaze_at(example.instrument(posterior=False).theta, points)
    count = len(points)
    loadings = np.zeros((count, 5, 1))
    loadings[:, 0, 0] = 3e-4 * gaze.x1c
    return Observations(
        ids=tuple(f"r{i}" for i in range(count)),
        groups=tuple(f"r{i}" for i in range(count)),
        x1c=gaze.x1c,
        y1c=gaze.y1c,
        alpha2_rad=gaze.alpha2,
        gaze_residual_rad=gaze.residual,
        z_mm=points[:, 2],
        std=np.full((count, 5), 1e-4),
        shared=loadings if shared else np.zeros((0, 0, 0)),
        shared_names=("focal length",) if shared else (),
    )


POINTS = np.array(
    [[-60.0, 20, 500], [10, -5, 650], [120, 40, 800], [-100, 0, 900], [260, -60, 1000]]
)


SETUP = Setup(RowSettings(1e-4, 0.0, 0.002, 1e-3, 0.0))
FOCAL = Setup(
    SETUP.settings,
    CameraSet(Camera(np.diag([1000.0, 1000.0, 1.0]), np.zeros(0), (1280, 960))),
    CommonErrors(("c1.fx",), np.array([[3.0]])),
)


def _calibrated(*, shared: bool) -> CalibratedInstrument:
    plain = example.instrument(posterior=True)
    errors = SharedErrors(("focal length",), np.zeros((4, 1))) if shared else None
    return CalibratedInstrument(
        model="axis-offset",
        instrument=Instrument(plain.parameters, plain.reading, errors),
        noise_factor=1.0,
        calibrated_mm=np.array([500.0, 1000.0]),
        setup=FOCAL if shared else SETUP,
    )


def _validation(rows: Observations) -> tuple[ValidationRows, ValidationResult]:
    depth_of = np.array([0, 1, 1, 3, 4])
    z = rows.z_mm[depth_of] + 2.0
    prediction = DepthPrediction(
        z_mm=z,
        u_mm=np.full(5, 3.0),
        low95_mm=z - 6,
        high95_mm=z + 6,
        gum_u_mm=np.full(5, 3.0),
        gum_valid=np.ones(5, dtype=bool),
    )
    known = np.array([500.0, 650, 650, np.nan, 1000])
    result = ValidationResult(
        ids=rows.ids,
        groups=rows.groups,
        reference_mm=known,
        depth_of=depth_of,
        prediction=prediction,
        position_mm=np.zeros((5, 3)),
        own_depth_mm={},
        errors=(),
    )
    return ValidationRows(rows, depth_of, {}), result


LENGTHS = LengthTable(
    file="lengths.csv",
    line=(2, 3, 4),
    ids=("near", "board", "unknown"),
    start=("r0", "r1", "r0"),
    end=("r4", "r2", "r1"),
    length_mm=np.array([598.0, 118.0, np.nan]),
    u_length_mm=np.array([0.5, 0.5, np.nan]),
)


def _gather(*, shared: bool = False, seed: int = 0) -> Evidence:
    rows = _rows(POINTS, shared=shared)
    validation, measured = _validation(rows)
    return gather_evidence(
        _calibrated(shared=shared),
        rows,
        validation,
        measured,
        LENGTHS,
        check_reference="ruler",
        depth_rel=0.02,
        rule="guard-band",
        seed=SeedSequence(seed),
    )


@pytest.fixture(scope="module")
def found() -> Evidence:
    return _gather()


def test_depths_span_the_calibration_at_its_least_certain_ray(found: Evidence) -> None:
    depths = [d.result.z_mm for d in found.depths]
    np.testing.assert_allclose(depths, [500, 620, 750, 880, 1000], atol=11)
    assert (depths[0], depths[-1]) == pytest.approx((500, 1000))
    assert not any(d.extrapolated for d in found.depths)
    x1c = POINTS[:, 0] / POINTS[:, 2]
    for d in found.depths:
        assert min(abs(d.result.x1c - x1c)) < 1e-12


def test_checks_are_the_rows_gazed_at_with_a_reference(found: Evidence) -> None:
    assert [c.name for c in found.checks] == ["r0", "r1", "r4"]
    assert all(c.conformity is not None for c in found.checks)


def test_lengths_with_a_reference_use_the_depth_their_row_borrows(found: Evidence) -> None:
    assert [e.name for e in found.lengths] == ["near", "board"]
    # r2 has the depth of r1, 650 mm, at its own ray: not the distance of the points themselves.
    ray = POINTS[2] / POINTS[2, 2]
    expected = np.linalg.norm(650 * ray - POINTS[1])
    assert found.lengths[1].measured_mm == pytest.approx(expected, rel=1e-9)
    direct = np.linalg.norm(POINTS[4] - POINTS[0])
    assert found.lengths[0].measured_mm == pytest.approx(direct, rel=1e-9)
    assert found.length_limit is not None
    assert found.length_limit.count == 2


def test_equal_seeds_give_equal_evidence(found: Evidence) -> None:
    again = _gather()
    assert [d.result for d in again.depths] == [d.result for d in found.depths]
    assert again.lengths == found.lengths


def test_shared_errors_of_the_intrinsics_make_depths_less_certain(found: Evidence) -> None:
    shared = _gather(shared=True)
    for with_them, without in zip(shared.depths, found.depths, strict=True):
        rows = {row.input.name: row for row in with_them.result.budget.rows}
        # 3 px of 1000 px: x1c is wrong by 0.003 of itself, all over the field.
        slope = rows["x1c"].input.sensitivity
        by_focal = abs(slope * 3e-3 * with_them.result.x1c)
        assert rows["focal length"].contribution == pytest.approx(by_focal, rel=1e-6)
        u = without.result.budget.standard_uncertainty
        assert with_them.result.budget.standard_uncertainty >= u


def test_evidence_can_be_stored(found: Evidence) -> None:
    document, arrays = serialise(found)
    again = deserialise(document, arrays, Evidence)
    assert again.checks == found.checks
    assert again.lengths == found.lengths
    assert again.depths[0].result == found.depths[0].result
    np.testing.assert_array_equal(
        again.depths[0].position.covariance_mm2, found.depths[0].position.covariance_mm2
    )


def test_a_depth_without_upper_limit_is_reported_not_raised() -> None:
    values = example.VALUES[:2]
    loose = ParameterKnowledge(
        names=("baseline_mm", "delta2_rad"),
        values=values,
        covariance=np.diag([4.0, 0.06**2]),
        degrees_of_freedom=None,
        evaluation=("A", "A"),
    )
    calibrated = CalibratedInstrument(
        model="base",
        instrument=Instrument(loose, example.READING),
        noise_factor=1.0,
        calibrated_mm=np.array([500.0, 1000.0]),
        setup=SETUP,
    )
    found = gather_evidence(
        calibrated,
        _rows(POINTS, shared=False),
        None,
        None,
        None,
        check_reference=None,
        depth_rel=None,
        rule="simple",
        seed=SeedSequence(1),
    )
    assert found.not_certified
    assert "no end" in found.not_certified[-1].reason
    assert found.checks == ()
    assert found.length_limit is None


def test_a_covariance_of_many_parameters_stands_whole_in_tables_that_a_page_holds() -> None:
    """Property: an adjustment frees eleven parameters, and their row is wider than a page."""
    plain = example.inputs(posterior=False)
    free = [i for i, entry in enumerate(PARAMETERS) if entry.name != "reference_offset_mm"][:11]
    rng = np.random.default_rng(5)
    root = np.diag(rng.uniform(1e-4, 1e-1, 11)) @ (np.eye(11) + 0.1 * rng.normal(size=(11, 11)))
    known = ParameterKnowledge(
        names=tuple(PARAMETERS[i].name for i in free),
        values=rng.normal(size=11),
        covariance=root @ root.T,
        degrees_of_freedom=None,
        evaluation=("A",) * 11,
    )
    summary = plain.calibration
    rig = replace(summary.instrument, parameters=known)
    annex = _correlations(replace(summary, instrument=rig, identified_by=("data",) * 11))
    parts = [table for table in annex.tables if table.title.startswith("Covariance")]
    assert all(len(table.columns) <= 1 + COLUMNS for table in parts)
    shown = [sum((table.rows[i][1:] for table in parts), ()) for i in range(11)]
    assert [len(row) for row in shown] == [11] * 11
    scales = np.array([SHOWN[PARAMETERS[i].unit].factor for i in free])
    np.testing.assert_allclose(
        np.array(shown, float), known.covariance * np.outer(scales, scales), rtol=1e-6
    )
