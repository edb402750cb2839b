"""Depths by rigs whose references count from elsewhere than C1's optical centre, said or not.

Evidence: simulated truth, by repetition.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.random import SeedSequence

from calib.fit.priors import Priors
from calib.geometry.parameters import INDEX, PARAMETERS, REFERENCE_OFFSET
from calib.study.conditions import CONDITIONS
from calib.study.rigs import INSIDE, StudiedRig, set_up
from calib.study.trial import calibrated

RIGS = 60
ROWS = (14, 24)
"""Rigs have so many rows in turn."""

AHEAD_MM = (0.0, 5.0, 10.0, 20.0, 40.0, 60.0)
U_SAID_MM = 2.0

SEED = 61


def counted_from(bench: StudiedRig, ahead_mm: float, said: float | None) -> StudiedRig:
    """References `ahead_mm` in front of the centre; `said` is what the manifest states of it."""
    unsaid = PARAMETERS[INDEX[REFERENCE_OFFSET]].prior_std
    assert unsaid is not None
    prior = (0.0, unsaid) if said is None else (0.0, U_SAID_MM)
    z = bench.rows.z_mm - ahead_mm + (said or 0.0)
    return replace(
        bench,
        rows=replace(bench.rows, z_mm=z),
        priors=Priors({**bench.priors.stated, REFERENCE_OFFSET: prior}),
    )


def held(ahead_mm: float, *, is_said: bool) -> tuple[float, float, float]:
    """Share of depths inside their 95 % intervals, its standard error, the median of u(z)/z."""
    inside, u = [], []
    for number in range(RIGS):
        rows = ROWS[number % len(ROWS)]
        # `base` is not selected where the origin is open (`calib.fit.compare`).
        condition = replace(CONDITIONS["axis-offset-14"], rows=rows, fitted=("axis-offset",))
        seeds = SeedSequence((SEED, number)).spawn(5)
        said = ahead_mm + U_SAID_MM * np.random.default_rng(seeds[4]).standard_normal()
        bench = counted_from(
            set_up(condition, seed=SEED, number=number), ahead_mm, said if is_said else None
        )
        found = calibrated(condition, bench, seeds[:4])["depths"][INSIDE]
        inside.append(np.mean(found["measure95"]))
        u.append(np.median(found["u_rel"]))
    spread = float(np.std(inside, ddof=1) / np.sqrt(RIGS))
    return float(np.mean(inside)), spread, float(np.median(u))


@pytest.mark.slow
@pytest.mark.parametrize("is_said", [True, False], ids=["said", "not said"])
@pytest.mark.parametrize("ahead_mm", AHEAD_MM)
def test_depths_keep_their_intervals_wherever_references_count_from(
    ahead_mm: float, is_said: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    coverage, error, u = held(ahead_mm, is_said=is_said)
    with capsys.disabled():
        said = "said" if is_said else "not said"
        sys.stdout.write(
            f"\n{ahead_mm:g} mm, {said}: {coverage:.3f} +- {error:.3f} inside, u(z)/z {u:.4f}\n"
        )
    assert 0.93 <= coverage <= 0.98
