"""Rows rejected as outliers. Evidence: simulated truth, with negative controls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import SeedSequence

from calib.fit.compare import compare_samples
from calib.fit.importance import ImportanceSample, sample_importance
from calib.fit.noise import CLEAN, ROBUST, SPARE_FREEDOM, Tails, reject_outliers
from calib.fit.posterior import laplace, posterior_of
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_robust
from calib.geometry.parameters import MODELS
from calib.rows.observations import Observations
from calib.simulate.rig import draw_rig
from calib.simulate.tables import simulate_rows

PRIORS = Priors({})
SPOILT = (3, 11, 17)


def rows_of(number: int, *, count: int = 30, model: str = "axis-offset") -> Observations:
    rng = np.random.default_rng((8, number))
    rig = draw_rig(rng, model=model)
    return simulate_rows(rig, rng, count=count, depth_range_mm=rig.depth_range_mm).observed


def spoil(rows: Observations, which: tuple[int, ...] = SPOILT) -> Observations:
    """Shift readings of some rows by 20 mrad, 20 standard deviations and more."""
    alpha2 = rows.alpha2_rad.copy()
    alpha2[list(which)] += 0.02
    return replace(rows, alpha2_rad=alpha2)


def fitted(rows: Observations, model: str) -> tuple[RobustFit, ImportanceSample]:
    fit = fit_robust(rows, MODELS[model], PRIORS)
    target = posterior_of(fit, rows, PRIORS)
    return fit, sample_importance(target, *laplace(fit, target), np.random.default_rng(0))


@pytest.mark.parametrize("number", range(3))
def test_gross_errors_change_nothing_but_the_number_of_rows(number: int) -> None:
    """The spoilt table gives the posterior of the table without these rows.

    Tolerances: four Monte Carlo errors of two samples with 5000 effective draws (0.08 of a standard
    deviation) and 4 % of it for the robust fit's weights, taken at slightly different parameters.
    """
    clean = rows_of(number)
    rest = clean.take(~np.isin(np.arange(len(clean)), SPOILT))
    fit, sample = fitted(spoil(clean), "axis-offset")
    assert fit.outliers == tuple(clean.ids[i] for i in SPOILT)
    other_fit, other = fitted(rest, "axis-offset")
    assert fit.noise_scale == pytest.approx(other_fit.noise_scale, rel=1e-3)
    std = np.sqrt(np.diag(other.covariance))
    assert np.all(np.abs(sample.mean - other.mean) < 0.12 * std)
    assert np.sqrt(np.diag(sample.covariance)) == pytest.approx(std, rel=0.12)


def test_model_choice_does_not_hang_on_gross_errors() -> None:
    """The extended model is as far ahead with gross errors as without these rows."""
    clean = rows_of(0)
    rest = clean.take(~np.isin(np.arange(len(clean)), SPOILT))
    lead = []
    for rows in (spoil(clean), rest):
        found = {model: fitted(rows, model) for model in ("base", "axis-offset")}
        comparison = compare_samples(
            rows,
            {name: fit for name, (fit, _) in found.items()},
            {name: sample for name, (_, sample) in found.items()},
            PRIORS,
            seed=SeedSequence(1),
        )
        assert comparison.selected == "axis-offset"
        lead.append(comparison.scores[1].loo - comparison.scores[0].loo)
        if rows is not rest:
            same = comparison.scores[0].pointwise == comparison.scores[1].pointwise
            assert tuple(np.flatnonzero(same)) == SPOILT
    assert lead[0] == pytest.approx(lead[1], rel=0.2)


def test_few_rows_are_all_kept() -> None:
    """Negative control: with six rows nobody can say which is the outlier."""
    standardised = np.array([0.5, -0.3, 0.2, 0.1, -0.4, 40.0])
    assert not reject_outliers(standardised, 1.0, parameters=2.0).any()
    many = np.append(standardised, np.full(6, 0.3))
    assert reject_outliers(many, 1.0, parameters=2.0).sum() == 1
    assert not reject_outliers(many, 1.0, parameters=11 - SPARE_FREEDOM + 0.1).any()


@pytest.mark.parametrize(
    ("count", "gross", "tails"),
    [
        (14, (), CLEAN),
        (14, (3, 11), CLEAN),
        (8, (2,), ROBUST),
        (6, (), CLEAN),
        (6, (2,), ROBUST),
    ],
)
def test_tails_are_robust_where_outliers_stay_in(
    count: int, gross: tuple[int, ...], tails: Tails
) -> None:
    """Nearly normal rows: those of clean tables, and those left once all outliers are aside."""
    for number in range(3):
        rows = spoil(rows_of(number, count=count, model="base"), gross)
        fit = fit_robust(rows, MODELS["base"], PRIORS)
        assert fit.tails == tails
        assert tuple(np.flatnonzero(fit.rejected)) == (gross if tails == CLEAN else ())


def test_too_many_are_no_outliers() -> None:
    """Negative control: where over a third disagrees, none is rejected."""
    standardised = np.concatenate([np.full(18, 0.5), np.full(12, 30.0)])
    assert not reject_outliers(standardised, 1.0, parameters=2.0).any()


def test_clean_rows_are_hardly_ever_set_aside() -> None:
    """At a risk of 1 % a table: of 40 clean tables none or one, two one time in twenty."""
    hit = [fitted_aside(rows_of(100 + i)) for i in range(40)]
    assert sum(hit) <= 2


def fitted_aside(rows: Observations) -> bool:
    return bool(fit_robust(rows, MODELS["axis-offset"], PRIORS).rejected.any())
