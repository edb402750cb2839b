"""Scores and claims. Evidence: made-up records whose scores are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from calib.study.claims import LEAST_RIGS, judge, verdict_text
from calib.study.conditions import CONDITIONS, GROUPS, MISTAKES, chosen
from calib.study.scores import StudyScore, score_all

RIGS = 400


def records(*, width: float = 1.0, shift: float = 0.0) -> list[dict[str, Any]]:
    """Records of rigs whose posterior is normal, `width` times too narrow and `shift` off."""
    rng = np.random.default_rng(0)
    made = []
    for number in range(RIGS):
        miss = rng.standard_normal(2) + shift
        depth_miss = rng.standard_normal(20)
        rank = np.array([normal(x * width) for x in np.append(miss, depth_miss)])
        parameters = {
            name: {
                "truth": 3.0, "bound": 2.0, "ideal": 3.0 + 2 * m, "identified_by": "data",
                "robust": [3.0 + 2 * m, 2.0], "posterior": [3.0 + 2 * m, 2.0 / width, r],
                "linear": 3.0 + 4 * m,
            }
            for name, m, r in zip(("baseline_mm", "delta2_rad"), miss, rank, strict=False)
        }  # fmt: skip
        depth = {
            "rank": list(rank[2:]), "error_rel": list(0.01 * depth_miss),
            "u_rel": [0.01] * 20, "measure95": [float(abs(m) < 1.96) for m in depth_miss],
        }  # fmt: skip
        made.append({
            "condition": "base-14", "number": number, "selected": "base",
            "parameters": parameters, "noise_scale": [1.0, 0.0, 0.1, float(rng.random())],
            "depths": {"inside": depth, "beyond": depth},
        })  # fmt: skip
    return made


def normal(x: float) -> float:
    from scipy.stats import norm

    return float(norm.cdf(x))


def find(scores: tuple[StudyScore, ...], **wanted: str) -> StudyScore:
    (one,) = [s for s in scores if all(getattr(s, k) == v for k, v in wanted.items())]
    return one


def test_an_honest_posterior_is_scored_as_one() -> None:
    """400 rigs: coverage of a parameter is known to 1.1 %, of depth (8000) to 0.25 %."""
    scores = score_all(records())
    who = {"subject": "baseline_mm", "estimator": "posterior"}
    assert find(scores, **who, statistic="pull_rms").value == pytest.approx(1, abs=0.12)
    assert find(scores, **who, statistic="coverage95").value == pytest.approx(0.95, abs=0.035)
    assert find(scores, **who, statistic="uniformity_p").value > 0.01
    depth = {"subject": "depth inside", "estimator": "selected"}
    for level in (50, 90, 95):
        coverage = find(scores, **depth, statistic=f"coverage{level}")
        assert coverage.value == pytest.approx(level / 100, abs=0.02)
        assert coverage.std_error == pytest.approx(
            np.sqrt(level / 100 * (1 - level / 100) / 8000), rel=0.2
        )
    assert find(scores, subject="model", estimator="base", statistic="share").value == 1
    linear = find(scores, subject="baseline_mm", estimator="linear", statistic="efficiency")
    assert linear.value == pytest.approx(0.25)
    assert linear.std_error == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(("width", "shift"), [(1.4, 0.0), (0.7, 0.0), (1.0, 0.8)])
def test_a_dishonest_posterior_is_found_out(width: float, shift: float) -> None:
    """Negative control: too narrow, too wide, shifted by 0.8 standard deviations."""
    scores = score_all(records(width=width, shift=shift))
    p = find(scores, subject="baseline_mm", estimator="posterior", statistic="uniformity_p")
    assert p.value < 1e-3
    verdicts = {v.claim: v for v in judge(scores)}
    pulls = next(v for claim, v in verdicts.items() if claim.startswith("pulls"))
    assert pulls.broken


def test_rigs_on_which_too_simple_a_model_was_selected_are_scored_apart() -> None:
    """By definition: of rigs with an axis offset, one in four measured by `base`, wrongly."""
    made = [dict(r, condition="axis-offset-6", averaged=r["depths"]) for r in records()]
    missed = {"rank": [1.0] * 20, "error_rel": [0.1] * 20, "u_rel": [0.01] * 20,
              "measure95": [0.0] * 20}  # fmt: skip
    for r in made[::4]:
        r["depths"] = {"inside": missed, "beyond": missed}
    for r in made[1::4] + made[2::4] + made[3::4]:
        r["selected"] = "axis-offset"
    scores = score_all(made)
    rash = {"subject": "depth inside, base selected", "statistic": "coverage95"}
    assert find(scores, **rash, estimator="selected").value == 0
    assert find(scores, **rash, estimator="selected").rigs == RIGS / 4
    assert find(scores, **rash, estimator="averaged").value == pytest.approx(0.95, abs=0.02)
    whole = find(scores, subject="depth inside", estimator="selected", statistic="coverage95")
    assert whole.value == pytest.approx(0.75 * 0.95, abs=0.02)


def test_failed_rigs_are_counted_not_scored() -> None:
    made = [*records(), {"condition": "base-14", "number": RIGS, "failed": "no answer"}]
    scores = score_all(made)
    failed = find(scores, statistic="failed")
    assert (failed.value, failed.rigs) == (1.0, RIGS)


def test_names_of_conditions_stand_for_themselves_and_groups() -> None:
    assert chosen(("base-14", "default")) == ("base-14", *(
        name for name in GROUPS["default"] if name != "base-14"))  # fmt: skip
    assert set(GROUPS["all"]) >= set(CONDITIONS)


@pytest.mark.parametrize("rigs", [4, LEAST_RIGS - 1, 400])
def test_rigs_that_all_agree_prove_nothing_while_they_are_few(rigs: int) -> None:
    """Property: every interval holds the truth, on few rigs by chance, on 400 being too wide."""
    made = records()[:rigs]
    for record in made:
        for depth in record["depths"].values():
            depth["rank"] = [0.5] * len(depth["rank"])
    scores = score_all(made)
    inside = find(scores, subject="depth inside", estimator="selected", statistic="coverage95")
    assert inside.value == 1
    assert inside.std_error is not None
    # All of n agree: an honest error is of the order of 1/n (rule of three: 3/n at 95 %).
    assert 1 / (rigs + 4) < inside.std_error < 3 / (rigs + 4)
    (verdict,) = [v for v in judge(scores) if "inside the calibrated range" in v.claim]
    assert not verdict.held
    assert verdict.broken == (rigs >= LEAST_RIGS)
    assert ("too few" in verdict_text(verdict)) == (rigs < LEAST_RIGS)


@pytest.mark.parametrize(
    ("value", "error", "rigs", "mark", "enough"),
    [
        (0.95, 0.005, 500, "held", None),
        (0.935, 0.004, 500, "held", None),
        (0.935, 0.006, 500, "open", 720),  # 500 (0.006 / 0.005)^2
        (0.928, 0.006, 500, "open", 28125),  # 500 (2.5 * 0.006 / 0.002)^2
        (0.90, 0.006, 500, "BROKEN", None),
        (0.95, 0.001, LEAST_RIGS - 1, "open", LEAST_RIGS),
        (0.93, 0.006, 500, "open", None),
    ],
)
def test_a_claim_is_held_only_beyond_the_error_of_its_score(
    value: float, error: float, rigs: int, mark: str, enough: int | None
) -> None:
    score = StudyScore("base-14", "depth inside", "selected", "coverage95", value, error, rigs)
    (verdict,) = [v for v in judge([score]) if "inside the calibrated range" in v.claim]
    assert verdict_text(verdict).startswith(mark)
    assert (verdict.held, verdict.broken) == (mark == "held", mark == "BROKEN")
    assert verdict.decided_by == (None if enough is None else pytest.approx(enough, abs=1))


def test_cases_of_one_rig_are_one_witness() -> None:
    """Closed form: eight rigs with five like cases each err as eight cases do, not as forty."""

    def rig(number: int, *named: str) -> dict[str, object]:
        case = {"fault": "backlash", "rows": 24, "effect": 5.0, "gain": 9.0}
        case |= {"named": list(named), "with_depths": None}
        return {
            "condition": MISTAKES,
            "number": number,
            "clean": {},
            "clean_with_depths": [],
            "mistakes": [case] * 5,
            "pairs": [],
        }

    names = [("backlash",), (), ("backlash",), ("backlash",), (), ("backlash",), ("backlash",), ()]
    made = [rig(i, *name) for i, name in enumerate(names)]
    score = find(score_all(made), subject="24 rows", statistic="named")
    share = 5 / 8
    assert (score.value, score.rigs) == (share, 8)
    assert score.std_error == pytest.approx(np.sqrt(share * (1 - share) / 7))
