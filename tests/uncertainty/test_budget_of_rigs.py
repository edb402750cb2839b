"""Budgets of fitted rigs, the paper's and simulated ones: shares an auditor can read.

Evidence: an independent tool (GTC), its parameters as correlated as the fit has them.
"""

from __future__ import annotations

import math
from pathlib import Path

import GTC
import numpy as np
import pytest

from calib.dataset.load import load_dataset
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_model
from calib.geometry.parameters import REFERENCE_OFFSET
from calib.instrument.calibrated import instrument_from_draws
from calib.rows.from_table import Setup, row_priors, row_settings
from calib.rows.observations import Observations
from calib.rows.repeated_readings import observe_gazes
from calib.study.conditions import CONDITIONS
from calib.study.rigs import set_up
from calib.uncertainty.depth import depth_budget, reading_at
from calib.uncertainty.measurement import Instrument

PAPER = Path(__file__).parents[2] / "datasets" / "xu-wang-2017"
MODEL = "axis-offset"
DRAWS = 4000


def of_paper() -> tuple[Instrument, Observations]:
    dataset = load_dataset(PAPER)
    assert dataset.gaze is not None
    setup = Setup(row_settings(dataset))
    rows = observe_gazes(dataset.gaze, setup, None)
    return instrument(fit_model(rows, Priors(row_priors(dataset)), model=MODEL), rows, setup), rows


def of_study(number: int) -> tuple[Instrument, Observations]:
    bench = set_up(CONDITIONS["axis-offset-14"], seed=5, number=number)
    fit = fit_model(bench.rows, bench.priors, model=MODEL)
    return instrument(fit, bench.rows, bench.setup), bench.rows


def instrument(fit: RobustFit, rows: Observations, setup: Setup) -> Instrument:
    rng = np.random.default_rng(1)
    draws = rng.multivariate_normal(fit.values, fit.covariance, DRAWS)
    noise = np.full((DRAWS, 1), math.log(fit.noise_scale))
    draws = np.hstack([draws, noise])
    return instrument_from_draws(draws, np.zeros((DRAWS, 0)), fit, rows, setup).instrument


@pytest.mark.parametrize("rig", ["paper", 0, 1, 2])
def test_shares_are_those_of_gtc_and_can_be_read(rig: str | int) -> None:
    found, rows = of_paper() if isinstance(rig, str) else of_study(rig)
    p = found.parameters
    names = [name for name in p.names if name != REFERENCE_OFFSET]
    some = [p.names.index(name) for name in names]
    covariance = p.covariance[np.ix_(some, some)]
    u = np.sqrt(np.diag(covariance))
    correlated = max(abs((covariance / np.outer(u, u))[0, 1:]))
    assert correlated > 0.9, "the parameters as such make no budget that can be read"
    for z_mm in np.quantile(rows.z_mm, [0.0, 0.5, 1.0]):
        reading = reading_at(found.theta, z_mm=float(z_mm), x1c=0.1)
        table = depth_budget(found, reading)
        shares = [row.share_percent for row in table.rows]
        assert table.correlations == ()
        assert all(-5 <= share <= 100 for share in shares)
        assert sum(shares) == pytest.approx(100, abs=1e-6)
        parameters = GTC.multiple_ureal(p.values[some].tolist(), u.tolist(), math.inf)
        for i in range(len(names)):
            for j in range(i):
                r = float(covariance[i, j] / u[i] / u[j])
                GTC.set_correlation(r, parameters[i], parameters[j])
        at = dict(zip(names, parameters, strict=True))
        angle = GTC.ureal(reading.alpha2_rad, 1e-30) + at["delta2_rad"]
        z = (
            at["baseline_mm"]
            + at["axis_z_mm"] / GTC.tan(angle)
            + at["eccentricity_mm"] / GTC.sin(angle)
        ) / (0.1 + 1 / GTC.tan(angle))
        of_parameters = 100 * (GTC.uncertainty(z) / table.standard_uncertainty) ** 2
        ours = sum(
            share
            for share, row in zip(shares, table.rows, strict=True)
            if row.input.name in (*names, "baseline_at_mean_gaze_mm")
        )
        assert ours == pytest.approx(of_parameters, rel=1e-5)
