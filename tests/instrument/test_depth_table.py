"""What holds for the calibrated depths does not hang on the range of the table.

Evidence: simulated truth; before, a table far from the rows let `calib measure` take 1.96 for its
intervals and judged the gate on depth where the table was.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import SeedSequence

from calib.fit.robust import fit_model
from calib.instrument.calibrated import (
    CalibratedInstrument,
    DepthTable,
    instrument_from_draws,
    tabulate_depths,
)
from calib.study.conditions import CONDITIONS
from calib.study.rigs import set_up
from calib.uncertainty.montecarlo import NORMAL_FACTOR


@pytest.fixture(scope="module")
def calibrated() -> CalibratedInstrument:
    bench = set_up(CONDITIONS["axis-offset-6"], seed=3, number=0)
    fit = fit_model(bench.rows, bench.priors, model="axis-offset")
    rng = np.random.default_rng(1)
    # A Student distribution: tails that make the factor larger than the normal one.
    draws = rng.multivariate_normal(np.zeros(len(fit.values)), fit.covariance, 4000)
    draws = fit.values + draws / np.sqrt(rng.chisquare(4, 4000) / 4)[:, None]
    noise = np.full((4000, 1), np.log(fit.noise_scale))
    return instrument_from_draws(
        np.hstack([draws, noise]), np.zeros((4000, 0)), fit, bench.rows, bench.setup
    )


def test_the_range_of_the_table_changes_nothing_of_calibrated_depths(
    calibrated: CalibratedInstrument,
) -> None:
    low, high = calibrated.calibrated_mm

    def table(first: float, last: float) -> DepthTable:
        return tabulate_depths(calibrated, low_mm=first, high_mm=last, seed=SeedSequence(5))

    usual = table(low, high)
    middle = (low + high) / 2
    assert usual.factor95 > 1.03 * NORMAL_FACTOR
    assert usual.middle_mm == pytest.approx(middle)
    for ends in ((low / 4, low / 2), (3 * high, 6 * high), (1.0, 1e6), (low, middle)):
        other = table(*ends)
        assert other.depth_mm[[0, -1]] == pytest.approx(ends)
        assert other.factor95 == usual.factor95
        assert (other.middle_mm, other.middle_u_mm) == (usual.middle_mm, usual.middle_u_mm)
    wide = table(0.5 * low, 1.5 * high)
    assert wide.factor95 == pytest.approx(usual.factor95, rel=0.03)
    assert wide.middle_u_mm / wide.middle_mm == pytest.approx(
        usual.middle_u_mm / usual.middle_mm, rel=0.1
    )
