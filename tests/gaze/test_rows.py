"""Rows and tracks from pictures. Evidence: simulated truth and properties."""

from __future__ import annotations

import numpy as np
import pytest
from test_targets import BOARD, imager, on_board

from calib.gaze import follow
from calib.gaze.row import SeenTarget, TargetScatter, make_row, refuse_moved, refuse_unsteady
from calib.gaze.target import TargetObservation
from calib.rig.protocols import Frame, Refused, Standstill
from calib.simulate.render import render

NOTHING = np.zeros((4, 4), np.uint8)


def seen(at, *, exposed_ns=2_000, serial=0, floor=0.025):
    return SeenTarget(
        Frame(NOTHING, exposed_ns, "trigger", serial),
        TargetObservation(np.array(at, float), floor, 20.0),
    )


def scattered(rng, count, std, at=(320.0, 240.0)):
    return [seen(np.array(at) + std * rng.standard_normal(2)) for _ in range(count)]


def standing():
    return Standstill(1.5, 1_000, "load encoder", 10, 1, "a")


def test_a_picture_from_before_the_standstill_makes_no_row():
    parts = {
        "c1": [seen((1, 1))],
        "noise_c1": TargetScatter(),
        "noise_c2": TargetScatter(),
        "moves": 1,
        "looks": 0,
    }
    assert make_row(standing(), c2=[seen((1, 1))], **parts).moves == 1
    with pytest.raises(Refused, match=r"exposed 0\.0 ms before it stood still"):
        make_row(standing(), c2=[seen((1, 1)), seen((1, 1), exposed_ns=999)], **parts)


def test_the_uncertainty_is_that_of_repeats_and_never_below_the_floor():
    rng = np.random.default_rng(1)
    noise = TargetScatter()
    assert noise.std_px == pytest.approx(0.05)
    for _ in range(100):
        noise = noise.after(scattered(rng, 4, 0.03))
    assert noise.std_px == pytest.approx(0.03, rel=0.1)
    row = make_row(
        standing(), c1=scattered(rng, 4, 0.0), c2=scattered(rng, 4, 0.03),
        noise_c1=TargetScatter(1e-9, 100), noise_c2=noise, moves=1, looks=0,
    )  # fmt: skip
    assert row.u_c1_px == pytest.approx(0.025, rel=1e-3)
    assert row.u_c2_px == pytest.approx(np.hypot(0.025, noise.std_px / 2))


def test_a_target_at_rest_passes_and_one_that_moved_does_not():
    rng = np.random.default_rng(2)
    noise = TargetScatter(0.03**2 * 100, 100)
    refused = 0
    for _ in range(200):
        try:
            refuse_moved("C1", scattered(rng, 2, 0.03), scattered(rng, 2, 0.03), noise)
            refuse_unsteady("C2", scattered(rng, 4, 0.03), noise)
        except Refused:
            refused += 1
    assert refused < 6
    with pytest.raises(Refused, match=r"C1 sees it 0\.2"):
        refuse_moved("C1", [seen((10, 10))] * 2, [seen((10.2, 10))] * 2, noise)
    with pytest.raises(Refused, match="C2 sees the target at different places"):
        refuse_unsteady("C2", [seen((10, 10))] * 3 + [seen((10.3, 10))], noise)


def test_flow_follows_a_moving_board_and_says_how_fast_it_goes():
    what, pattern, point = on_board(BOARD)
    sight = imager()
    rng = np.random.default_rng(3)
    frames, true = [], []
    for k in range(8):
        pose = np.eye(4)
        pose[:3, 3] = np.array([-60.0 + 12 * k, 5.0 * k, 1500.0]) - point
        pixels = render(sight, pattern, pose, rng)
        frames.append(Frame(pixels, 40_000_000 * k, "trigger", k))
        true.append(what.find(pixels).pixel)
    track = follow.start(frames[0], true[0])
    for frame, pixel in zip(frames[1:], true[1:], strict=True):
        track = follow.flowed(track, frame)
        assert track is not None
        assert np.hypot(*(track.pixels[-1] - pixel)) < 0.1
    assert track.velocity == pytest.approx((true[-1] - true[-4]) / 0.12, rel=0.05)
    assert track.at(frames[-1].exposed_ns + 40_000_000) == pytest.approx(
        2 * true[-1] - true[-2], abs=0.3
    )


def test_flow_that_does_not_come_back_is_lost():
    rng = np.random.default_rng(4)
    noise = [rng.integers(0, 255, (480, 640), dtype=np.uint8) for _ in range(2)]
    first, second = (Frame(n, 40_000_000 * k, "trigger", k) for k, n in enumerate(noise))
    assert follow.flowed(follow.start(first, np.array([320.0, 240.0])), second) is None
