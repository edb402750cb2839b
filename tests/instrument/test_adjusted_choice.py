"""Whether gaze rows agree with the adjustment of all pictures, and which of the two is of record.

Evidence: simulated truth by repetition, with errors of known size; the closed form of chi-squared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from calib.core.errors import UsageError
from calib.core.gate import Gate
from calib.geometry.misclosure import misclosure
from calib.geometry.parameters import INDEX
from calib.geometry.plane import OBSERVABLE
from calib.images.adjustment.result import Adjustment, adjust
from calib.instrument.adjusted import (
    ADJUSTMENT,
    BY_RULE,
    CONTRADICTED,
    ROWS,
    Agreement,
    agreement,
    choose,
    refuse_missing,
)
from calib.rows.common_errors import CommonErrors
from calib.rows.from_table import direction_by_common
from calib.rows.observations import Observations
from calib.simulate.rig import TrueRig
from calib.simulate.tables import draw_targets, observe
from tests.images.rig_sessions import everything, session

COUNT = 30
FEW = 8
ALONE = CommonErrors()
"""Rows that have no estimated quantity in common with the pictures."""


@dataclass(frozen=True)
class Scene:
    rig: TrueRig
    adjustment: Adjustment

    def rows(self, seed: int) -> Observations:
        """Gaze rows of the rig, which the adjustment has not seen."""
        rng = np.random.default_rng(seed)
        points = draw_targets(self.rig, rng, count=COUNT, depth_range_mm=self.rig.depth_range_mm)
        return observe(self.rig, rng, points, residual_measured=True).observed


@pytest.fixture(scope="module")
def scene() -> Scene:
    rng = np.random.default_rng(11)
    rig = everything(rng)
    pictured = session(rng, rig)
    pair = pictured.pair(rng, (True, True))
    found = adjust(*pictured.corners(rng, 0.1), pictured.taken, pictured.board, pair)
    assert found.passed
    return Scene(rig, found)


def test_rows_of_the_same_rig_agree_as_chance_has_it(scene: Scene) -> None:
    """Chi-squared of 30 has a standard deviation of 7.7; the mean of 12, which share the
    adjustment's own error, one of some 3."""
    found = [agreement(scene.adjustment, scene.rows(seed), ALONE) for seed in range(12)]
    assert {one.freedom for one in found} == {COUNT}
    assert 20 < np.mean([one.statistic for one in found]) < 40
    assert min(one.probability for one in found) > CONTRADICTED


def test_rows_that_miss_by_less_than_three_of_their_u_contradict_all_the_same(scene: Scene) -> None:
    """By two of their standard uncertainties, all to one side: of each row that might be chance."""
    rows, record = scene.rows(1), scene.adjustment.complete
    theta = scene.rig.theta
    true = theta[[INDEX[name] for name in record.names]]
    exact = replace(record, values=true, covariance=1e-6 * record.covariance)
    known = replace(scene.adjustment, models=(exact,))
    found = misclosure(theta, rows.gaze, rows.z_mm)
    sigma = np.sqrt((found.by_observable**2 * rows.std**2).sum(axis=1))
    z = OBSERVABLE.z
    moved = replace(rows, z_mm=rows.z_mm + 2 * sigma / found.by_observable[:, z])
    assert agreement(known, rows, ALONE).probability > 0.01
    told = agreement(known, moved, ALONE)
    assert np.sqrt(told.statistic / COUNT) < 3
    choice = choose(BY_RULE, known, told, corrected=False)
    assert choice.method == ROWS
    assert "rows contradict its gaze planes" in choice.reason


def test_noise_is_no_contradiction_where_the_rows_themselves_show_it(scene: Scene) -> None:
    rng, rows = np.random.default_rng(3), scene.rows(2)
    noisy = replace(
        rows,
        alpha2_rad=rows.alpha2_rad
        + 8 * rows.std[:, OBSERVABLE.alpha2] * rng.standard_normal(COUNT),
    )
    assert agreement(scene.adjustment, noisy, ALONE).probability < CONTRADICTED
    assert agreement(scene.adjustment, noisy, ALONE, noise_factor=8.0).probability > CONTRADICTED


def test_one_mistaken_row_speaks_for_no_other(scene: Scene) -> None:
    rows = scene.rows(4)
    depths = rows.z_mm.copy()
    depths[5] *= 1.2
    spoilt = replace(rows, z_mm=depths)
    assert agreement(scene.adjustment, spoilt, ALONE).probability < CONTRADICTED
    without = agreement(scene.adjustment, spoilt, ALONE, outliers=(rows.ids[5],))
    assert (without.freedom, without.probability > CONTRADICTED) == (COUNT - 1, True)


def test_an_error_that_rows_of_a_pose_share_counts_once(scene: Scene) -> None:
    """The same covariance written as one shared error a pose gives the same statistic."""
    rows = scene.rows(7)
    pose, u_pose = np.arange(COUNT) % 5, 8 * rows.std[:, OBSERVABLE.z]
    std = rows.std.copy()
    std[:, OBSERVABLE.z] = np.hypot(std[:, OBSERVABLE.z], u_pose)
    stated = replace(rows, std=std, z_group=pose, u_z_group_mm=u_pose)
    loadings = np.zeros((COUNT, 5, 5))
    loadings[np.arange(COUNT), OBSERVABLE.z, pose] = u_pose
    shared = replace(
        rows,
        shared=np.concatenate([rows.shared, loadings], axis=2) if rows.shared_names else loadings,
        shared_names=(*rows.shared_names, *(f"pose {i}" for i in range(5))),
    )
    found, wanted = (agreement(scene.adjustment, one, ALONE) for one in (stated, shared))
    assert found.statistic == pytest.approx(wanted.statistic, rel=1e-9)
    apart = agreement(scene.adjustment, replace(stated, z_group=np.arange(COUNT)), ALONE)
    assert abs(apart.statistic - found.statistic) > 0.5


def test_what_the_adjustment_itself_leaves_uncertain_counts(scene: Scene) -> None:
    """Its parameters zero off by one standard deviation, which is made large."""
    record = scene.adjustment.complete
    at = record.names.index("delta2_rad")
    wide = record.covariance.copy()
    wide[at, at] += np.deg2rad(0.2) ** 2
    values = record.values.copy()
    values[at] += np.deg2rad(0.2)
    off = replace(record, values=values)
    known = replace(scene.adjustment, models=(off,))
    unsure = replace(scene.adjustment, models=(replace(off, covariance=wide),))
    rows = scene.rows(8)
    assert (
        agreement(known, rows, ALONE).probability
        < CONTRADICTED
        < agreement(unsure, rows, ALONE).probability
    )


def test_lenses_that_rows_and_parameters_have_in_common_count_once(scene: Scene) -> None:
    """Errors of both drawn together 60 times, with lenses known twenty times less well."""
    record, rng = scene.adjustment.complete, np.random.default_rng(9)
    by_lens = record.with_lens @ np.linalg.pinv(record.lens_covariance, rcond=1e-12)
    lens = 400 * record.lens_covariance
    record = replace(
        record,
        lens_covariance=lens,
        with_lens=by_lens @ lens,
        covariance=record.covariance + by_lens @ (lens - record.lens_covariance) @ by_lens.T,
    )
    shared = CommonErrors.of(record.lens_names, lens)
    theta = scene.rig.theta[[INDEX[name] for name in record.names]]
    joint = np.block([[record.covariance, record.with_lens], [record.with_lens.T, lens]])
    unit = np.sqrt(np.diag(joint))
    errors = unit * rng.multivariate_normal(
        np.zeros(len(unit)), joint / np.outer(unit, unit), size=60, method="eigh"
    )
    found, apart = [], []
    for i, error in enumerate(errors):
        rows = scene.rows(100 + i).take(np.arange(FEW))
        loading = np.zeros((FEW, len(OBSERVABLE), shared.factor.shape[1]))
        at_rays = np.stack([rows.x1c, rows.y1c], axis=1)
        loading[:, :2] = direction_by_common(at_rays, record.cameras[0], shared)
        own = np.linalg.pinv(shared.factor, rcond=1e-9) @ error[len(theta) :]
        seen = replace(
            rows,
            x1c=rows.x1c + loading[:, 0] @ own,
            y1c=rows.y1c + loading[:, 1] @ own,
            shared=loading,
            shared_names=shared.error_names,
        )
        estimate = replace(record, values=theta + error[: len(theta)])
        adjusted = replace(scene.adjustment, models=(estimate,))
        found.append(agreement(adjusted, seen, shared).statistic)
        apart.append(agreement(adjusted, seen, ALONE).statistic)
    # Chi-squared of 8: the mean of 60 has a standard deviation of 0.5.
    assert np.mean(found) == pytest.approx(FEW, abs=1.6)
    assert np.mean(apart) < FEW - 1


def test_the_order_of_reasons(scene: Scene) -> None:
    good, bad = Agreement(30.0, 30, 0.47), Agreement(90.0, 30, 1e-7)
    failed = replace(scene.adjustment, gates=(Gate("adjustment-views", passed=False, detail=""),))
    assert choose(ROWS, scene.adjustment, good, corrected=False).method == ROWS
    assert choose(ADJUSTMENT, failed, bad, corrected=True).method == ADJUSTMENT
    assert choose(BY_RULE, scene.adjustment, good, corrected=False).method == ADJUSTMENT
    assert choose(BY_RULE, scene.adjustment, None, corrected=False).method == ADJUSTMENT
    for adjustment, agrees, corrected, words in (
        (failed, good, False, "adjustment-views"),
        (scene.adjustment, good, True, "corrections"),
        (scene.adjustment, bad, False, "p = 1e-07"),
    ):
        found = choose(BY_RULE, adjustment, agrees, corrected=corrected)
        assert found.method == ROWS
        assert words in found.reason


def test_an_adjustment_that_is_not_there_is_not_chosen() -> None:
    refuse_missing(BY_RULE, None)
    with pytest.raises(UsageError, match="there is no adjustment"):
        refuse_missing(ADJUSTMENT, None)
