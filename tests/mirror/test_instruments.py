"""An instrument back from the mirror measures as its image does, shared errors and all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.camera import Camera, intrinsic_names
from calib.geometry.mirror import mirror_camera, mirror_matrix, shared_signs
from calib.geometry.parameters import vector
from calib.geometry.plane import OBSERVABLE, Gaze, gaze_at
from calib.mirror.instruments import mirror_budget, mirror_instrument
from calib.mirror.problem import Mirror
from calib.rows.common_errors import CommonErrors
from calib.rows.from_table import direction_by_common
from calib.uncertainty.depth import depth_budget
from calib.uncertainty.measurement import (
    Instrument,
    ParameterKnowledge,
    Reading,
    ReadingSpread,
    SharedErrors,
    Spread,
)
from calib.uncertainty.predictive import linear_positions

NAMES = ("baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm")
FLIP = np.array([-1.0, 1, 1])
CAMERA = Camera(
    np.array([[700.0, 0, 330], [0, 710, 250], [0, 0, 1]]),
    np.array([-0.2, 0.05, 1e-3, -2e-3, 0.01]),
    (640, 480),
)
POINTS = np.array([[150.0, 40, 900], [-90, -60, 1400], [30, 10, 2000]])


def _covariance(size: int, seed: int) -> FloatArray:
    root = np.random.default_rng(seed).normal(size=(size, size))
    covariance: FloatArray = root @ root.T
    return covariance


def _shared(camera: Camera, covariance: FloatArray) -> CommonErrors:
    return CommonErrors.of(tuple(f"c1.{name}" for name in intrinsic_names(camera)), covariance)


def _instrument(shared: CommonErrors) -> Instrument:
    unit = np.array([0.5, 5e-4, 2.0, 1.0])
    count = shared.factor.shape[1]
    by_shared = unit[:, None] * np.random.default_rng(7).normal(size=(4, count + 1)) / 3
    parameters = ParameterKnowledge(
        names=NAMES,
        values=np.array([90.0, 0.01, -15.0, 4.0]),
        covariance=_covariance(4, 1) * np.outer(unit, unit) + by_shared @ by_shared.T,
        degrees_of_freedom=None,
        evaluation=("A",) * 4,
    )
    reading = ReadingSpread(Spread(2e-4), Spread(2e-4), Spread(1e-4, 3e-4), Spread(1e-4))
    sources = SharedErrors((*shared.error_names, "pose"), by_shared, of_rows_alone=1)
    return Instrument(parameters, reading, sources)


def _loadings(gaze: Gaze, camera: Camera, shared: CommonErrors) -> FloatArray:
    loadings = np.zeros((len(gaze), OBSERVABLE.z, shared.factor.shape[1]))
    xy = np.stack([gaze.x1c, gaze.y1c], axis=1)
    loadings[:, : OBSERVABLE.alpha2] = direction_by_common(xy, camera, shared)
    return loadings


def test_positions_and_budgets_of_a_left_rig_are_those_of_its_image() -> None:
    scale = np.array([0.5, 0.5, 0.8, 0.6, 1e-3, 1e-3, 1e-5, 1e-5, 1e-3])
    covariance = _covariance(9, 2) * np.outer(scale, scale)
    right = _shared(CAMERA, covariance)
    names = tuple(f"c1.{name}" for name in intrinsic_names(CAMERA))
    # What a left rig states of itself, and what the calibration made of it.
    camera = mirror_camera(CAMERA)
    left = _shared(camera, mirror_matrix(covariance, shared_signs(names)))
    mirror = Mirror.of(left)
    np.testing.assert_allclose(mirror.shared(left).factor, right.factor, atol=1e-12)
    instrument = _instrument(right)
    own = mirror_instrument(instrument, mirror)

    gaze = gaze_at(instrument.theta, POINTS)
    seen = gaze_at(own.theta, POINTS * FLIP)
    here = linear_positions(instrument, gaze, _loadings(gaze, CAMERA, right))
    there = linear_positions(own, seen, _loadings(seen, camera, left))
    np.testing.assert_allclose(there.position_mm, here.position_mm * FLIP, rtol=1e-12)
    np.testing.assert_allclose(
        there.covariance_mm2, here.covariance_mm2 * np.outer(FLIP, FLIP), rtol=1e-9
    )
    for i in range(len(POINTS)):
        budgets = [
            depth_budget(
                which,
                Reading(float(g.x1c[i]), float(g.y1c[i]), float(g.alpha2[i]), shared=loads[i]),
            )
            for which, g, loads in (
                (instrument, gaze, _loadings(gaze, CAMERA, right)),
                (own, seen, _loadings(seen, camera, left)),
            )
        ]
        mirrored, expected = mirror_budget(budgets[0]), budgets[1]
        for row, wanted in zip(mirrored.rows, expected.rows, strict=True):
            assert row.input.name == wanted.input.name
            figures = (row.input.estimate, row.input.sensitivity, row.share_percent)
            others = (wanted.input.estimate, wanted.input.sensitivity, wanted.share_percent)
            np.testing.assert_allclose(figures, others, rtol=1e-9, atol=1e-12)
        assert [p.first for p in mirrored.correlations] == [p.first for p in expected.correlations]
        np.testing.assert_allclose(
            [p.correlation for p in mirrored.correlations],
            [p.correlation for p in expected.correlations],
            rtol=1e-9,
        )


def test_twice_in_the_mirror_is_where_it_began() -> None:
    shared = _shared(CAMERA, _covariance(9, 3))
    mirror, instrument = Mirror.of(shared), _instrument(shared)
    back = mirror_instrument(mirror_instrument(instrument, mirror), mirror)
    np.testing.assert_array_equal(back.parameters.covariance, instrument.parameters.covariance)
    np.testing.assert_array_equal(back.by_shared, instrument.by_shared)
    lopsided = replace(instrument, shared=None)
    assert mirror_instrument(lopsided, mirror).theta[0] == -vector({"baseline_mm": 90.0})[0]
