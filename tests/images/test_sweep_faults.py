"""What is wrong with a sweep is named. Evidence: simulated rigs, negative controls."""

from __future__ import annotations

from dataclasses import replace

import board_scenes as scenes
import numpy as np
import pytest
from sweep_scenes import (
    LENS_STD,
    NARROW,
    WIDE,
    drawn_rig,
    solve,
    unchanged,
)

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Corners
from calib.geometry.parameters import INDEX, STANDOFF
from calib.images.sweep.solve import SweepReadings
from calib.images.sweep.yaw_axis import yaw_sweep
from calib.simulate.rig import draw_rig


@pytest.mark.parametrize("readings", [WIDE, NARROW], ids=["wide", "narrow"])
def test_wrong_sign_of_the_encoder_is_named(readings: FloatArray) -> None:
    rng = np.random.default_rng(7)

    def edit(found: Corners, shown: SweepReadings) -> tuple[Corners, SweepReadings]:
        return found, replace(shown, alpha2_rad=np.pi - shown.alpha2_rad)

    with pytest.raises(EstimationError, match="alpha2 counts the wrong way round"):
        solve(rng, drawn_rig(rng), readings=readings, edit=edit)


def test_wrong_sign_is_named_though_few_images_could_follow_it() -> None:
    """Six images a board at counts of 0.05625 degrees, the intrinsics well known: readings that all
    err, by thousands of their uncertainties, would make the images fit to 0.9 px."""
    rng = np.random.default_rng(14)
    rig = replace(drawn_rig(rng), resolution_rad=float(np.deg2rad(0.05625)))

    def edit(found: Corners, shown: SweepReadings) -> tuple[Corners, SweepReadings]:
        return found, replace(shown, alpha2_rad=np.pi - shown.alpha2_rad)

    few = np.deg2rad(np.linspace(60, 95, 6))
    with pytest.raises(EstimationError, match="alpha2 counts the wrong way round"):
        solve(rng, rig, readings=few, sigma_px=0.02, lens_std=0.1 * LENS_STD, edit=edit)


@pytest.mark.parametrize("sign", [1, -1])
def test_an_axis_far_away_is_not_taken_for_a_wrong_sign(sign: int) -> None:
    """The board turns about an axis 5.4 m ahead of C2, in whichever sense."""
    rng = np.random.default_rng(15)
    rig = draw_rig(rng, model="axis-offset", fixed={STANDOFF: -5400.0})

    def edit(found: Corners, shown: SweepReadings) -> tuple[Corners, SweepReadings]:
        turned = np.pi / 2 + sign * (shown.alpha2_rad - np.pi / 2)
        return found, replace(shown, alpha2_rad=turned)

    with pytest.raises(EstimationError, match="in either sense of the encoder"):
        solve(rng, rig, readings=np.deg2rad(np.linspace(88.5, 91.5, 7)), edit=edit)


def test_a_reading_so_wrong_that_its_image_is_left_out_is_named() -> None:
    """Sharp corners contradict a reading off by 1 degree all at once, and leave as outliers."""
    rng = np.random.default_rng(11)
    rig = replace(drawn_rig(rng), resolution_rad=float(np.deg2rad(0.018)))

    def edit(found: Corners, shown: SweepReadings) -> tuple[Corners, SweepReadings]:
        off = shown.alpha2_rad.copy()
        off[5] += np.deg2rad(1.0)
        return found, replace(shown, alpha2_rad=off)

    result = solve(rng, rig, sigma_px=0.02, lens_std=0.1 * LENS_STD, edit=edit)
    failed = [gate for gate in result.gates if not gate.passed]
    assert [gate.name for gate in failed] == ["sweep-images"]
    assert result.images[5] in failed[0].detail
    e = rig.theta[INDEX["eccentricity_mm"]]
    assert abs(result.eccentricity_mm - e) < 4 * result.eccentricity_std_mm


def test_a_wrong_reading_is_named() -> None:
    rng = np.random.default_rng(15)

    def edit(found: Corners, shown: SweepReadings) -> tuple[Corners, SweepReadings]:
        alpha2 = np.array(shown.alpha2_rad)
        alpha2[4] += np.deg2rad(5.0)
        return found, replace(shown, alpha2_rad=alpha2)

    right, wrong = (solve(rng, drawn_rig(rng), edit=e) for e in (unchanged, edit))
    assert [g.name for g in right.gates if not g.passed] == []
    detail = {g.name: g.detail for g in wrong.gates if not g.passed}
    assert wrong.images[4] in detail["sweep-readings"]
    assert "check alpha2_deg of this image" in detail["sweep-readings"]


def test_wrong_unit_of_the_encoder_is_named() -> None:
    rng = np.random.default_rng(8)

    def edit(found: Corners, shown: SweepReadings) -> tuple[Corners, SweepReadings]:
        gear = 0.8 * (shown.alpha2_rad - np.pi / 2) + np.pi / 2
        return found, replace(shown, alpha2_rad=gear)

    result = solve(rng, drawn_rig(rng), edit=edit)
    assert result.encoder_scale == pytest.approx(0.25, abs=0.04)
    detail = {g.name: g.detail for g in result.gates if not g.passed}
    assert "gear ratio" in detail["sweep-encoder"]


def test_board_that_moved_fails_the_fit() -> None:
    rng = np.random.default_rng(9)

    def edit(found: Corners, shown: SweepReadings) -> tuple[Corners, SweepReadings]:
        return found, replace(shown, placements=("one",) * len(shown.placements))

    with pytest.raises(EstimationError, match="check that the board was at rest"):
        solve(rng, drawn_rig(rng), edit=edit)


def test_miscounted_board_is_named() -> None:
    rng = np.random.default_rng(10)
    rig = drawn_rig(rng)
    scene = scenes.sweep(rng, rig, readings=WIDE)
    shown = SweepReadings(scene.alpha2_rad, scene.placements, rig.resolution_rad, 0.0)
    wrong = replace(scenes.BOARD, columns=6, rows=9, target=(0, 0))
    with pytest.raises(EstimationError, match="sweep: in the median view a board of 6 x 9"):
        yaw_sweep(scene.found, shown, wrong, camera=rig.c2, covariance=np.zeros((9, 9)))


def test_too_few_readings_are_refused() -> None:
    rng = np.random.default_rng(11)
    with pytest.raises(EstimationError, match="2 readings of the encoder"):
        solve(rng, drawn_rig(rng), readings=np.array([1.5, 1.6]))
