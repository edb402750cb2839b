"""Choice of targets. Evidence: properties (against brute force) and simulated truth."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import pytest

from calib.core.errors import UsageError
from calib.geometry.camera import Camera
from calib.geometry.parameters import MODELS, vector
from calib.plan.advise import advise, regular
from calib.plan.design import (
    Knowledge,
    RowNoise,
    choose,
    d_criterion,
    depth_vectors,
    g_criterion,
    relative_variance,
    row_vectors,
    rows_at,
)
from calib.plan.field import Field, field_of

FIELD = Field((-0.5, 0.5), (-0.4, 0.4), float("inf"), (np.deg2rad(40.0), np.deg2rad(140.0)))
NOISE = RowNoise(np.array([2e-4, 2e-4, 3e-4, 0.0]), z_mm=0.0, z_rel=0.002)


def knowledge(model: str = "axis-offset") -> Knowledge:
    prior = np.diag([1e-4, 1e2, 20.0**-2, 10.0**-2])[: len(MODELS[model].free)]
    size = len(MODELS[model].free)
    return Knowledge(MODELS[model], vector({"baseline_mm": 120.0}), prior[:, :size])


def small_problem() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Information, eight candidates and asked depths."""
    start = knowledge()
    points = FIELD.grid(start.theta, (600.0, 1400.0), high=False)[::19][:8]
    assert len(points) == 8
    candidates = row_vectors(start, rows_at(start, points, NOISE))
    return regular(start), candidates, depth_vectors(start, FIELD, np.array([800.0, 1600.0]))


@pytest.mark.parametrize("criterion", ["G", "D"])
def test_exchange_finds_what_brute_force_finds(criterion: str) -> None:
    """Property: of all 120 triples of eight candidates, the chosen is within 1 % of the best."""
    information, candidates, asked = small_problem()

    def cost(rows: tuple[int, ...]) -> float:
        chosen = candidates[list(rows)]
        matrix = information + chosen.T @ chosen
        if criterion == "D":
            return float(1 / np.linalg.det(matrix))
        return float(relative_variance(np.linalg.inv(matrix), asked).max())

    rule = d_criterion if criterion == "D" else g_criterion(asked)
    chosen = choose(information, candidates, rule, count=3)
    best = min(cost(rows) for rows in combinations_with_replacement(range(8), 3))
    assert cost(tuple(chosen)) <= 1.01 * best


def test_criteria_are_the_matrices_they_stand_for() -> None:
    """Property: the rank-one update equals inverting the sum, for every candidate."""
    information, candidates, asked = small_problem()
    covariance = np.linalg.inv(information)
    g, d = g_criterion(asked)(covariance, candidates), d_criterion(covariance, candidates)
    for i, row in enumerate(candidates):
        after = information + np.outer(row, row)
        expected = relative_variance(np.linalg.inv(after), asked).max()
        assert g[i] == pytest.approx(expected, rel=1e-6)
        ratio = np.linalg.det(information) / np.linalg.det(after)
        assert d[i] == pytest.approx(ratio, rel=1e-6)


def test_advice_beats_random_and_each_target_helps() -> None:
    """Property: u(z) falls with each target and ends below the median of random sets."""
    asked = np.array([900.0, 1500.0])
    advice = advise(
        knowledge(), FIELD, NOISE, np.random.default_rng(0),
        asked_mm=asked, between_mm=(600.0, 1500.0), count=5,
    )  # fmt: skip
    for targets in advice.targets.values():
        assert targets.points_mm.shape == (5, 3)
        steps = np.vstack([advice.before_rel, targets.u_rel])
        assert np.all(np.diff(steps, axis=0) <= 1e-12)
        assert FIELD.holds(knowledge().theta, targets.points_mm).all()
    g, d = (advice.targets[name].u_rel[-1].max() for name in ("G", "D"))
    assert g < 0.75 * advice.random_rel.max()
    assert g <= d


def test_what_cannot_be_seen_is_refused() -> None:
    narrow = Field((-0.5, 0.5), (-0.4, 0.4), float("inf"), (np.deg2rad(40), np.deg2rad(41)))
    with pytest.raises(UsageError, match="--yaw"):
        advise(
            knowledge(), narrow, NOISE, np.random.default_rng(0),
            asked_mm=np.array([900.0]), between_mm=(3000.0, 4000.0), count=3,
        )  # fmt: skip


def test_field_of_a_known_camera_is_its_image() -> None:
    """Property: without distortion the field is the image's edge, 95 % of it, over f."""
    camera = Camera(
        np.array([[800.0, 0, 400], [0, 800.0, 300], [0, 0, 1]]), np.zeros(5), (801, 601)
    )
    field = field_of(camera, camera, seen_x1c=np.zeros(0), seen_y1c=np.zeros(0), yaw_rad=(0.7, 2.4))
    assert field.x1c == pytest.approx((-0.475, 0.475))
    assert field.y1c == pytest.approx((-0.95 * 300 / 800, 0.95 * 300 / 800))
    assert field.half_height_c2 == pytest.approx(0.95 * 300 / 800)
    seen = field_of(
        None, None, seen_x1c=np.array([-0.1, 0.3]), seen_y1c=np.zeros(2), yaw_rad=(0.7, 2.4)
    )
    assert seen.x1c == (-0.1, 0.3)
