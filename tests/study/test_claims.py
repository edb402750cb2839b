"""The claims of docs/uncertainty.md, on 500 rigs a condition. Evidence: simulated truth."""

from __future__ import annotations

from pathlib import Path

import pytest

from calib.study.claims import CLAIMS, judge, verdict_text
from calib.study.conditions import chosen
from calib.study.run import run_study
from calib.study.scores import score_all

RIGS = 500


@pytest.mark.slow
def test_no_claim_is_broken_on_500_rigs(tmp_path: Path) -> None:
    """An hour on two cores; `calib study --rigs 500 --seed 1` with the same conditions."""
    conditions = chosen(("default", "ranks", "advice"))
    records = run_study(tmp_path / "rigs.jsonl", conditions, rigs=RIGS, seed=1, jobs=2)
    verdicts = judge(score_all(records))
    assert len(verdicts) == len(CLAIMS)
    broken = [verdict_text(v) for v in verdicts if v.broken]
    assert not broken, "\n".join(broken)
