"""Plates' corners. Evidence: pictures drawn ray by ray, with the truth of each."""

from __future__ import annotations

import numpy as np
import pytest
from plate_pictures import CORNER, camera, drawn_pose, picture, true_pixel

from calib.gaze.edges import EdgeLine, crossing
from calib.gaze.plate import CORNERS, LEAST_EDGE_PX, PlateCorner


@pytest.mark.parametrize("radius", [0.0, 10.0, 30.0])
def test_corners_are_where_the_edges_would_meet(radius: float) -> None:
    """Bars: 0.1 px is 2 mm in 1,400 at 2 m with a baseline of 200 mm and f = 1000 px."""
    lens, rng, pulls = camera(-0.2), np.random.default_rng(int(radius)), []
    for which in CORNERS:
        pose = drawn_pose(rng, which, depth_mm=rng.uniform(1000, 2000))
        seen = PlateCorner(which).through(lens).find(picture(lens, pose, rng, radius=radius))
        assert seen is not None
        error = seen.pixel - true_pixel(lens, pose, which)
        assert np.abs(error).max() < 0.1
        pulls.append(error / seen.floor_px)
    assert np.sqrt(np.mean(np.square(pulls))) < 1.3
    assert np.abs(pulls).max() < 3.5


def test_a_dark_plate_is_a_plate() -> None:
    lens, rng = camera(), np.random.default_rng(5)
    pose = drawn_pose(rng, "right-upper", depth_mm=1200)
    seen = PlateCorner("right-upper", lens).find(picture(lens, pose, rng, wall=180, metal=60))
    assert seen is not None
    np.testing.assert_allclose(seen.pixel, true_pixel(lens, pose, "right-upper"), atol=0.1)


def test_other_corners_are_not_taken_for_the_one_asked_for() -> None:
    lens, rng = camera(), np.random.default_rng(6)
    grey = picture(lens, drawn_pose(rng, "left-upper", depth_mm=1200), rng)
    for which in set(CORNERS) - {"left-upper", "left-lower"}:
        assert PlateCorner(which, lens).find(grey) is None
        assert "not in the picture" in PlateCorner(which, lens).fault(grey)


def test_what_cannot_be_measured_is_refused_with_the_reason() -> None:
    lens, rng = camera(), np.random.default_rng(7)
    pose = np.eye(4)
    pose[:3, 3] = [-150.0, 100.0, 1000.0]
    target = PlateCorner("left-upper", lens)
    plain = picture(lens, pose, rng)
    assert target.fault(plain) == ""
    bevel = picture(lens, pose, rng, bevel_mm=4.0)
    assert "second edge" in target.fault(bevel)
    # The plate is cut off shortly below its upper edge.
    short = pose.copy()
    short[1, 3] = 240.0 - 0.5 * LEAST_EDGE_PX
    assert "edge at plate:left-upper is" in target.fault(picture(lens, short, rng))
    two = plain.copy()
    two[60:200, 340:520] = 170
    assert "2 corners look like" in target.fault(two)
    nothing = rng.normal(100, 2, (480, 640)).clip(0, 255).astype(np.uint8)
    assert target.find(nothing) is None


def test_the_covariance_of_a_crossing() -> None:
    """Lines through noisy points, 4,000 times; fitted by plain least squares, no product code."""
    rng, places = np.random.default_rng(8), []
    s = np.linspace(30, 130, 101)
    scatter = 0.05
    for _ in range(4000):
        slope = [np.polyfit(s, scatter * rng.standard_normal(len(s)), 1) for _ in range(2)]
        # One along x, y = a x + b; the other along y, x = c y + d.
        (a, b), (c, d) = slope
        x = (c * b + d) / (1 - a * c)
        places.append([x, a * x + b])
    variance, spread = scatter**2 / len(s), float(((s - s.mean()) ** 2).sum())
    lines = [
        EdgeLine(np.array(point), np.array(along), variance, spread, scatter, 100, 0.0, len(s))
        for point, along in (([80.0, 0.0], [1.0, 0.0]), ([0.0, 80.0], [0.0, 1.0]))
    ]
    place, covariance = crossing(*lines)
    np.testing.assert_allclose(place, 0, atol=1e-12)
    np.testing.assert_allclose(np.cov(np.transpose(places)), covariance, rtol=0.1, atol=2e-6)


def test_names() -> None:
    assert set(CORNER) == set(CORNERS)
    assert PlateCorner("left-lower").name == "plate:left-lower"
