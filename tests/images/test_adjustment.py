"""The adjustment of all pictures. Evidence: simulated truth (rigs of `calib.simulate.rig`, whose
geometry is coded apart), with coverage by repetition; jacobians by differences; properties.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rig_sessions import Layout, Pictured, everything, session
from scipy.stats import chi2

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.geometry.parameters import INDEX
from calib.geometry.poses import pose_matrix
from calib.images.adjustment.gather import Rows, Swept, gather
from calib.images.adjustment.model import evaluate
from calib.images.adjustment.mounting import HEIGHT, PITCH, RIG, pose_by_rig, pose_of
from calib.images.adjustment.result import AdjustedModel, Adjustment, adjust
from calib.images.adjustment.solve import solve
from calib.images.joint.reduced import Unknowns, eliminated
from calib.simulate.rig import TrueRig, c2_pose, draw_rig

SIGMA_PX = 0.1
EVERYTHING = Layout()


def unknowns_of(rig: TrueRig) -> FloatArray:
    """The truth in the order of `RIG`."""
    mount = {HEIGHT: rig.height_mm, PITCH: rig.pitch_rad}
    return np.array([rig.theta[INDEX[n]] if n in INDEX else mount[n] for n in RIG])


def adjusted(
    rng: np.random.Generator,
    pictured: Pictured,
    *,
    sigma_px: float = SIGMA_PX,
    layout: Layout = EVERYTHING,
) -> Adjustment:
    corners = pictured.corners(rng, sigma_px)
    pair = pictured.pair(rng, layout.free, u_given=layout.u_given)
    return adjust(*corners, pictured.taken, pictured.board, pair)


def statistic(model: AdjustedModel, rig: TrueRig) -> float:
    """Squared distance of the parameters from the truth in their own covariance."""
    error = model.values - rig.theta[[INDEX[name] for name in model.names]]
    scale = np.sqrt(np.diag(model.covariance))
    correlation = model.covariance / np.outer(scale, scale)
    return float(error / scale @ np.linalg.solve(correlation, error / scale))


def pulls(model: AdjustedModel, rig: TrueRig) -> FloatArray:
    error = model.values - rig.theta[[INDEX[name] for name in model.names]]
    return error / np.sqrt(np.diag(model.covariance))


@pytest.fixture(scope="module")
def scene() -> Pictured:
    rng = np.random.default_rng(6)
    return session(rng, everything(rng), Layout(rows=7, lens=6))


@pytest.mark.parametrize("is_left", [False, True])
def test_pose_of_c2_is_that_of_the_simulated_rig(is_left: bool) -> None:
    rng = np.random.default_rng(0)
    rig = replace(everything(rng, is_left=is_left), pitch_rad=0.02, height_mm=7.0)
    for reading in (1.1, 1.5, 1.9):
        pose, by_rig = pose_by_rig(unknowns_of(rig), reading)
        assert pose_matrix(pose) == pytest.approx(c2_pose(rig, np.array(reading)), abs=1e-9)
        for k in range(len(RIG)):
            step = 1e-6 * np.eye(len(RIG))[k]
            ends = [pose_by_rig(unknowns_of(rig) + s * step, reading)[0] for s in (1, -1)]
            assert by_rig[:, k] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-6)


def test_gradient_and_normals_are_those_of_central_differences() -> None:
    """Of the cost with own errors of readings at their best: eliminated in each picture."""
    rng = np.random.default_rng(1)
    pictured = session(rng, everything(rng), Layout(rows=3, lens=3, placements=1, swept=3))
    pair = pictured.pair(rng, (True, True))
    problem, start = gather(
        pictured.taken,
        pictured.corners(rng, SIGMA_PX),
        pictured.board,
        pair,
    )
    shared = start.shared.copy()
    shared[problem.at_warp] = 0.4, -0.2
    shared[problem.at_rig] = unknowns_of(pictured.rig) * 1.001
    shared[problem.at_held] = 0.3
    at = Unknowns(shared, start.own)
    weight = np.full(problem.pictures.pixels.shape[:2], 1 / SIGMA_PX**2)
    here = evaluate(problem, at, weight).normals
    steps = np.ones(problem.size) * 1e-6
    for c in (0, 1):
        steps[problem.at_lens(c)[:4]] = 1e-4
    names = dict(zip(problem.names, problem.at_rig, strict=True))
    steps[[place for name, place in names.items() if name.endswith("_mm")]] = 1e-4
    for k, step in enumerate(steps):
        ends = []
        for sign in (1, -1):
            moved = shared.copy()
            moved[k] += sign * step
            ends.append(evaluate(problem, Unknowns(moved, start.own), weight).normals)
        slope = (ends[0].cost - ends[1].cost) / (2 * step)
        gradient = 2 * here.shared_gradient[:, k].sum()
        size = np.sqrt(here.shared[:, k, k].sum() * here.cost)
        assert gradient == pytest.approx(slope, abs=1e-5 * size), k
    for v, k in ((0, 0), (1, 4), (len(start.own) - 2, 2)):
        ends = []
        for sign in (1, -1):
            own = start.own.copy()
            own[v, k] += sign * 1e-5
            ends.append(evaluate(problem, Unknowns(shared, own), weight).normals)
        slope = (ends[0].cost - ends[1].cost) / 2e-5
        size = np.sqrt(here.own[v, k, k] * here.cost)
        assert 2 * here.own_gradient[v, k] == pytest.approx(slope, abs=1e-5 * size)


def test_exact_corners_give_the_exact_rig() -> None:
    rng = np.random.default_rng(2)
    rig = everything(rng)
    few = Layout(rows=6, lens=5, swept=5)
    rig = replace(rig, resolution_rad=1e-9, noise=replace(rig.noise, encoder_rad=0.0))
    found = adjusted(rng, session(rng, rig, few), sigma_px=1e-7).complete
    # What is left is of the order of the 1e-7 px put in, against 0.01 mm and 0.1 mrad at 0.1 px.
    true = rig.theta[[INDEX[name] for name in found.names]]
    assert found.values == pytest.approx(true, abs=1e-4)
    assert found.mount == pytest.approx([rig.height_mm, rig.pitch_rad], abs=1e-4)
    assert found.board_warp_mm == pytest.approx((0.3, -0.2), abs=1e-4)


LAYOUTS = {
    "everything": Layout(),
    "left": Layout(is_left=True),
    "no pairs, no sweep": Layout(rows=14, placements=0, pairs=False),
    "given lenses": Layout(free=(False, False)),
    "uncertain lenses": Layout(free=(False, False), u_given=1e-3),
    "wide lens of C1": Layout(c1_field_deg=150.0),
}


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_parameters_within_their_covariance(layout: Layout) -> None:
    """Simulated truth: all parameters together, at a chance of 1e-4 to fail."""
    rng = np.random.default_rng(3)
    rig = everything(rng, is_left=layout.is_left, c1_field_deg=layout.c1_field_deg)
    found = adjusted(rng, session(rng, rig, layout), layout=layout)
    assert [gate for gate in found.gates if not gate.passed] == []
    model = found.complete
    assert statistic(model, rig) < chi2.isf(1e-4, len(model.names))
    assert found.rms_px == pytest.approx(SIGMA_PX, rel=0.05)
    at_reading = c2_pose(rig, np.array(model.reading_rad))
    error = pose_matrix(model.pose_12)[:3, 3] - at_reading[:3, 3]
    assert np.all(np.abs(error) < 4.5 * np.sqrt(np.diag(model.pose_covariance))[3:])


def test_a_model_that_the_pictures_contradict_is_refused() -> None:
    rng = np.random.default_rng(4)
    tilted = {"axis_tilt_x_rad": 0.01, "eccentricity_mm": 4.0}
    rig = draw_rig(rng, model="axis-offset", fixed=tilted)
    found = adjusted(rng, session(rng, rig))
    assert {m.model for m in found.models} == {"axis-tilt", "complete"}
    assert set(found.contradicted) == {"base", "axis-offset", "encoder"}
    assert "axis_tilt_x_rad is 0.0" in found.contradicted["axis-offset"]


def test_a_model_that_is_true_is_kept_and_no_less_certain() -> None:
    rng = np.random.default_rng(5)
    rig = draw_rig(rng, model="axis-offset")
    found = {m.model: m for m in adjusted(rng, session(rng, rig)).models}
    assert set(found) == {"axis-offset", "axis-tilt", "encoder", "complete"}
    plain, whole = found["axis-offset"], found["complete"]
    assert statistic(plain, rig) < chi2.isf(1e-4, len(plain.names))
    pick = [whole.names.index(name) for name in plain.names]
    ratio = np.diag(plain.covariance) / np.diag(whole.covariance)[pick]
    assert np.all(ratio < 1.5)
    assert ratio.min() < 1.0


def test_a_board_that_moved_and_a_slip_of_the_pen_are_named(scene: Pictured) -> None:
    rng, pictured, rig = np.random.default_rng(6), scene, scene.rig
    moved = dict(pictured.exact)
    other = pictured.taken.pairs[3][1]
    moved[other] = moved[other] + np.array([9.0, 4.0])
    readings = pictured.taken.rows.readings_rad.copy()
    readings[2] += np.deg2rad(3.0)
    taken = replace(pictured.taken, rows=replace(pictured.taken.rows, readings_rad=readings))
    found = adjusted(rng, replace(pictured, exact=moved, taken=taken))
    assert len(found.left_out) <= 4
    assert other in found.left_out or pictured.taken.pairs[3][0] in found.left_out
    rows = pictured.taken.rows
    assert rows.image_c2[2] in found.left_out or rows.image_c1[2] in found.left_out
    assert statistic(found.complete, rig) < chi2.isf(1e-4, len(found.complete.names))


def test_a_picture_named_twice_counts_once(scene: Pictured) -> None:
    rng, pictured = np.random.default_rng(7), scene
    corners = pictured.corners(rng, SIGMA_PX)
    pair = pictured.pair(rng, (True, True))
    taken = pictured.taken
    once = adjust(*corners, taken, pictured.board, pair).complete
    lens = tuple(names + tuple(p[c] for p in taken.pairs) for c, names in enumerate(taken.lens))
    again = replace(taken, lens=(lens[0], lens[1]))
    twice = adjust(*corners, again, pictured.board, pair).complete
    assert np.array_equal(once.values, twice.values)
    assert np.array_equal(once.covariance, twice.covariance)


def test_pictures_that_do_not_tell_the_rig_are_refused(scene: Pictured) -> None:
    rng = np.random.default_rng(8)
    held = replace(scene.taken, rows=Rows(), sweep=Swept())
    with pytest.raises(EstimationError, match=r"C2 turned by 0.0 deg and 5 are needed"):
        adjusted(rng, replace(scene, taken=held))
    few = replace(scene.taken, rows=Rows(), pairs=scene.taken.pairs[:2])
    with pytest.raises(EstimationError, match="2 boards are seen by both cameras"):
        adjusted(rng, replace(scene, taken=few))


def test_readings_on_whole_counts_err_by_less_than_a_count(scene: Pictured) -> None:
    """Property: truth 2e-5; as far as proven, and a tenth of what is stated is the least."""
    taken = replace(scene.taken, reading_std_rad=6e-5)
    found = adjusted(np.random.default_rng(9), replace(scene, taken=taken))
    assert 1.6e-5 < found.reading_std_rad < 4e-5


def test_the_minimum_is_one_in_all_directions(scene: Pictured) -> None:
    rng, pictured = np.random.default_rng(10), scene
    pair = pictured.pair(rng, (True, True))
    problem, start = gather(
        pictured.taken,
        pictured.corners(rng, SIGMA_PX),
        pictured.board,
        pair,
    )
    found = solve(problem, start)
    normals = evaluate(found.problem, found.reduced.at, found.weight).normals
    matrices, gradients = eliminated(normals, 0.0)
    root = np.sqrt(np.diag(matrices.sum(axis=0)))
    assert np.abs(gradients.sum(axis=0) / root).max() < 1e-4
    assert pose_of(found.rig, 1.5) == pytest.approx(c2_pose(pictured.rig, np.array(1.5)), abs=0.5)


RIGS = 25


@pytest.mark.slow
@pytest.mark.parametrize(
    "layout",
    [
        Layout(lens=10),
        Layout(rows=14, lens=10, placements=0, pairs=False),
        Layout(lens=10, c1_field_deg=150.0),
    ],
    ids=["everything", "no pairs, no sweep", "wide lens of C1"],
)
def test_uncertainties_hold_over_many_rigs(layout: Layout) -> None:
    """Coverage: pulls of all parameters over 25 rigs have a root mean square of 0.85 to 1.15."""
    found = []
    for seed in range(RIGS):
        rng = np.random.default_rng([11, seed])
        rig = everything(rng, c1_field_deg=layout.c1_field_deg)
        pictured = session(rng, rig, layout)
        pair = pictured.pair(rng, layout.free)
        corners = pictured.corners(rng, SIGMA_PX)
        s = solve(*gather(pictured.taken, corners, pictured.board, pair))
        # These rigs do not change between the pictures: without what is allowed for that.
        std = np.sqrt(np.diag(s.covariance - s.allowance))[s.problem.at_rig]
        found.append((s.rig - unknowns_of(rig)) / std)
    assert 0.85 < np.sqrt(np.mean(np.square(found))) < 1.15
