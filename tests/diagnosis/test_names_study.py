"""How often a mistake is named where there is none, and how often the right one is named.

Evidence: simulated truth, rigs of all conditions of the study, one row in ten a gross error among
them. The figures of a larger run stand in docs/uncertainty.md.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace

import numpy as np
import pytest

from calib.fit.robust import fit_model
from calib.simulate.faults import FAULTS
from calib.study.claims import judge, verdict_text
from calib.study.conditions import CONDITIONS, MISTAKES
from calib.study.faults import NOT_IN_ROWS, ROW_COUNTS, SIZES, UNSIZED, run_faults, size_of, spoiled
from calib.study.rigs import set_up
from calib.study.scores import score_all

SIZE = int(os.environ.get("CALIB_STUDY_SIZE", "4"))
"""Rigs; each is calibrated some seventy times."""

SEED = 4101


@pytest.mark.slow
def test_no_claim_on_mistakes_is_broken(capsys: pytest.CaptureFixture[str]) -> None:
    records = [run_faults(seed=SEED, number=number) for number in range(SIZE)]
    assert not [record for record in records if "failed" in record]
    verdicts = judge(score_all(records))
    assert len(verdicts) == 3
    with capsys.disabled():
        sys.stdout.write("\n" + "\n".join(verdict_text(v) for v in verdicts) + "\n")
    assert not [v.claim for v in verdicts if v.broken]


def test_scores_count_what_matters_and_what_the_rows_show() -> None:
    def made(
        fault: str, effect: float | None, gain: float | None, *named: str
    ) -> dict[str, object]:
        made = {"fault": fault, "rows": 24, "effect": effect, "gain": gain, "named": list(named)}
        return made | {"with_depths": [fault] if gain else None}

    def pair(effect: float, named: list[str], beside: list[str]) -> dict[str, object]:
        made = {"faults": ["unit", "backlash"], "rows": 24, "effect": effect}
        return made | {"named": named, "beside": beside}

    record = {
        "condition": MISTAKES,
        "number": 0,
        "clean": {"base-6": [], "base-14": ["backlash"], "base-60": None, "coarse-6": []},
        "clean_with_depths": [[], ["unit"], [], []],
        "mistakes": [
            made("reading-step", 5.0, 9.0, "reading-step", "reading-drift"),
            made("reading-step", 5.0, -4.0),
            made("backlash", 3.0, 8.0, "microstep"),
            made("backlash", 1.0, -4.0),
            made("unit", None, None),
        ],
        "pairs": [
            pair(3.0, ["backlash"], ["unit"]),
            pair(3.0, ["backlash", "microstep"], []),
            pair(3.0, ["microstep"], ["rehomed"]),
            pair(1.0, [], []),
        ],
    }
    scores = {(s.subject, s.statistic): s for s in score_all([record])}
    assert scores["clean rigs", "false_names"].value == pytest.approx(1 / 3)
    assert scores["24 rows", "named"].value == pytest.approx(1 / 3)
    assert scores["24 rows", "wrong_name"].value == pytest.approx(1 / 3)
    assert scores["24 rows", "in_evidence"].value == pytest.approx(2 / 3)
    assert scores["24 rows", "named_in_evidence"].value == pytest.approx(1 / 2)
    assert scores["24 rows", "named_with_depths"].value == pytest.approx(1)
    assert scores["clean rigs", "false_names_with_depths"].value == pytest.approx(1 / 4)
    assert scores["backlash", "named"].rigs == 1
    two = {name: s.value for (subject, name), s in scores.items() if "two" in subject}
    assert two == pytest.approx({"one_named": 2 / 3, "both_named": 1 / 3, "wrong_pair": 1 / 3})


def test_mistakes_are_of_the_sizes_that_the_study_says() -> None:
    """The size is that of the misclosure in standard uncertainties, at most over the rows."""
    bench = set_up(replace(CONDITIONS["axis-offset-14"], rows=ROW_COUNTS[0]), seed=1, number=0)
    clean = fit_model(bench.rows, bench.priors, model="axis-offset")
    for place, fault in enumerate(FAULTS):
        if fault in (*NOT_IN_ROWS, *UNSIZED, "microstep", "c1-distortion-left-in"):
            continue
        _, wrong, _ = spoiled(fault, bench, clean, np.random.default_rng(place))
        size = size_of(wrong, bench.rows, clean.theta)
        assert 0.9 * SIZES[0] < size < 1.1 * SIZES[1], fault
