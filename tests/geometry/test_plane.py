"""The turning-plane model. Evidence: properties, central differences, the paper's formulae."""

from __future__ import annotations

import numpy as np
import pytest
from general_rigs import SIZE, general_rig
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry.misclosure import depth_jacobian, misclosure
from calib.geometry.parameters import COUNT, MODELS, NAMES, PARAMETERS, Model, embed, vector
from calib.geometry.plane import OBSERVABLE, Gaze, depth, encoder_reading, gaze_angle, gaze_at

rigs = st.builds(
    lambda baseline, others: vector(
        {"baseline_mm": baseline}
        | {p.name: x * SIZE[p.unit] for p, x in zip(PARAMETERS[1:], others, strict=True)}
    ),
    st.floats(60, 400),
    st.lists(st.floats(-1, 1), min_size=COUNT - 1, max_size=COUNT - 1),
)
points = st.builds(
    lambda *xyz: np.array([xyz]), st.floats(-300, 300), st.floats(-200, 200), st.floats(300, 2500)
)


def some_gazes(theta: np.ndarray, count: int = 40) -> tuple[Gaze, np.ndarray]:
    rng = np.random.default_rng(1)
    low, high = (-200, -100, 300), (300, 100, 2000)
    where = rng.uniform(low, high, size=(count, 3))
    gaze = gaze_at(theta, where)
    residual = rng.normal(0, 0.01, count)
    return Gaze(gaze.x1c, gaze.y1c, gaze.alpha2, residual), where[:, 2] * 1.02


@given(rigs, points)
def test_depth_inverts_gaze_at(theta: np.ndarray, point: np.ndarray) -> None:
    """Property: what the rig gazes at, it measures where it stands."""
    gaze = gaze_at(theta, point)
    z = depth(theta, gaze)
    # Rounding grows with z² / L: a turn by one unit in the last place moves far targets most.
    tolerance = 1e-13 * point[0, 2] ** 2 / theta[0] + 1e-12 * point[0, 2]
    np.testing.assert_allclose(z, point[:, 2], rtol=0, atol=50 * tolerance)


@given(rigs, st.floats(0.6, 2.5))
def test_encoder_reading_inverts_gaze_angle(theta: np.ndarray, angle: float) -> None:
    """Property: the reading found for an angle gives that angle."""
    reading = encoder_reading(theta, np.array([angle]))
    still = np.zeros(1)
    back = gaze_angle(theta, Gaze(still, still, reading, still))
    np.testing.assert_allclose(back, angle, rtol=0, atol=1e-14)


def test_untilted_closed_form() -> None:
    """Published: z (x1c + cot a) = L_b + Z_a cot a + e / sin a, e cos r - f sin r beside C2."""
    theta = vector(
        {
            "baseline_mm": 90,
            "delta2_rad": 0.01,
            "axis_z_mm": -20,
            "eccentricity_mm": 4,
            "standoff_mm": 60,
        }
    )
    gaze, _ = some_gazes(theta)
    a, r = gaze.alpha2 + gaze.residual + 0.01, gaze.residual
    offset = 4 * np.cos(r) - 60 * np.sin(r)
    expected = (90 - 20 / np.tan(a) + offset / np.sin(a)) / (gaze.x1c + 1 / np.tan(a))
    np.testing.assert_allclose(depth(theta, gaze), expected, rtol=1e-13)


def test_base_is_the_papers_law_with_the_cotangent() -> None:
    """Published: eq. (6) as it must read, z = L_b / (x1c + cot(alpha2 + delta2)); errata."""
    theta = vector({"baseline_mm": 77.09, "delta2_rad": np.arctan(0.0133)})
    gaze = Gaze(np.array([-0.0158]), np.zeros(1), np.arctan2(1, np.array([0.0629])), np.zeros(1))
    expected = 77.09 / (-0.0158 + 1 / np.tan(np.arctan2(1, 0.0629) + np.arctan(0.0133)))
    assert depth(theta, gaze)[0] == pytest.approx(expected, rel=1e-14)
    printed = 77.09 / (-0.0158 + np.tan(np.arctan2(1, 0.0629) + np.arctan(0.0133)))
    assert printed < 10, "eq. (6) as printed would put a target at 2.3 m within a centimetre"


def test_plane_of_the_general_model_from_first_principles() -> None:
    """Simulated truth: build C2's pose with rotation matrices, intersect the plane of a column."""
    theta = general_rig()
    values = dict(zip(NAMES, theta, strict=True))
    gaze, _ = some_gazes(theta)
    angle = gaze_angle(theta, gaze) - gaze.residual
    tx, tz, rho = (values[n] for n in ("axis_tilt_x_rad", "axis_tilt_z_rad", "gaze_roll_rad"))
    rx = np.array([[1, 0, 0], [0, np.cos(tx), -np.sin(tx)], [0, np.sin(tx), np.cos(tx)]])
    rz = np.array([[np.cos(tz), -np.sin(tz), 0], [np.sin(tz), np.cos(tz), 0], [0, 0, 1]])
    for i, a in enumerate(angle):
        axes = np.array([[np.sin(a), 0, np.cos(a)], [0, 1, 0], [-np.cos(a), 0, np.sin(a)]]).T
        turn = np.array([[np.cos(rho), -np.sin(rho), 0], [np.sin(rho), np.cos(rho), 0], [0, 0, 1]])
        pose = rz @ rx @ axes @ turn
        axis_point = np.array([values["baseline_mm"], 0, values["axis_z_mm"]])
        mount = np.array([values["eccentricity_mm"], 7.0, values["standoff_mm"]])
        on_plane = axis_point + pose @ mount
        column = pose @ np.array([np.tan(gaze.residual[i]), 0.3, 1.0])
        normal = np.cross(pose[:, 1], column)
        ray = np.array([gaze.x1c[i], gaze.y1c[i], 1])
        z = (normal @ on_plane) / (normal @ ray)
        one = Gaze(*(q[i : i + 1] for q in (gaze.x1c, gaze.y1c, gaze.alpha2, gaze.residual)))
        assert depth(theta, one)[0] == pytest.approx(z, rel=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_jacobian_by_parameter(name: str) -> None:
    """Central differences: their error is h² f''' / 6 plus rounding / h, far below 1e-8 here."""
    theta = general_rig()
    gaze, z = some_gazes(theta)
    i, h = NAMES.index(name), 1e-5
    step = np.zeros(COUNT)
    step[i] = h
    found = misclosure(theta, gaze, z).by_theta[:, i]
    ends = [misclosure(theta + sign * step, gaze, z).value for sign in (1, -1)]
    expected = (ends[0] - ends[1]) / (2 * h)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    found = depth_jacobian(theta, gaze).by_theta[:, i]
    expected = (depth(theta + step, gaze) - depth(theta - step, gaze)) / (2 * h)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("column", range(len(OBSERVABLE)))
def test_jacobian_by_observable(column: int) -> None:
    """Central differences, as above."""
    theta = general_rig()
    gaze, z = some_gazes(theta)
    observed = [gaze.x1c, gaze.y1c, gaze.alpha2, gaze.residual, z]
    h = 1e-6

    def value(sign: int) -> np.ndarray:
        moved = [q + sign * h * (k == column) for k, q in enumerate(observed)]
        return misclosure(theta, Gaze(*moved[:4]), moved[4]).value

    found = misclosure(theta, gaze, z).by_observable[:, column]
    np.testing.assert_allclose(found, (value(1) - value(-1)) / (2 * h), rtol=0, atol=1e-8)


def test_planes_of_many_vectors_are_those_of_each() -> None:
    """Property: one vector a gaze gives what each gives alone, residuals and roll included."""
    rng = np.random.default_rng(2)
    gaze, _ = some_gazes(general_rig())
    thetas = general_rig() * rng.uniform(0.9, 1.1, (len(gaze), COUNT))
    together = depth(thetas, gaze)
    for i, theta in enumerate(thetas):
        one = Gaze(*(q[i : i + 1] for q in (gaze.x1c, gaze.y1c, gaze.alpha2, gaze.residual)))
        assert together[i] == pytest.approx(depth(theta, one)[0], rel=1e-13)


def test_gaze_at_refuses_points_at_the_axis() -> None:
    """Negative control: within the eccentricity of the axis no plane reaches a point."""
    theta = vector({"baseline_mm": 80, "eccentricity_mm": 5})
    with pytest.raises(ValueError, match="eccentricity"):
        gaze_at(theta, np.array([[81.0, 0.0, 1.0]]))


def test_models_are_sets_of_the_one_table() -> None:
    """Property: free parameters are known, in order, and those of `base` are in all."""
    for model in MODELS.values():
        assert list(model.indices) == sorted(set(model.indices))
        assert set(MODELS["base"].free) <= set(model.free)
    assert Model("", ("delta2_rad", "baseline_mm")).free == MODELS["base"].free
    free = np.array([1.0, 2.0])
    np.testing.assert_array_equal(embed(free, MODELS["base"].free)[:3], [1.0, 2.0, 0.0])
    with pytest.raises(KeyError):
        vector({"baseline": 1.0})
