"""Scores of a study: from records of rigs to one long table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.stats import chi2

from calib.core.arrays import FloatArray
from calib.diagnosis.hypotheses import HYPOTHESES
from calib.study.conditions import ADVICE, CONDITIONS, MISTAKES
from calib.study.rigs import BEYOND, INSIDE

Record = dict[str, Any]

LEVELS = (0.5, 0.9, 0.95)

RIGS_PER_BIN = 25
MOST_BINS = 20
"""Rank bins: enough to see a wrong width, full enough for chi-squared (five is the usual least)."""

CLEAR_SIGMA = 5.0
"""An axis offset so many of its standard errors from 0 must not be overlooked."""

SIMPLE, EXTENDED = "base", "axis-offset"

RASH = ", base selected"
"""Of rigs that `base` does not describe, those on which it was selected all the same."""

DEPTHS = (("depths", "selected", "measure"), ("averaged", "averaged", "measure averaged"))
"""Key of the record, name of the estimator, and name of what `calib measure` makes of it."""

NOISE = "noise_scale"

HARM = 2.0
"""A mistake matters where it moves a depth by over so many u."""

EVIDENT = 2.0
"""Gain of a mistake alone, nats, from which the rows have evidence of it: odds of 7 to 1."""

MOST_NAMED = 2
"""A mistake counts as named if it is among so many at most."""

PENALTY = float(np.log(len(HYPOTHESES)))
"""What it costs in nats not to know which mistake to look for."""


@dataclass(frozen=True)
class StudyScore:
    """One figure of the table.

    Parameters
    ----------
    condition
        Name of the condition.
    subject
        A parameter, "depth inside" or "depth beyond", with `RASH` added or not, "model" or "rigs".
    estimator
        Whose figure it is: linear, bilinear, robust, posterior, a model, or of `DEPTHS`.
    statistic
        Bias in units of the bound, efficiency, pull_rms, coverage50, coverage90, coverage95,
        uniformity_p, u_rel, share, count.
    value, std_error
        With the standard error that the finite number of rigs leaves; None where it has none.
    rigs
        Rigs it is from.
    """

    condition: str
    subject: str
    estimator: str
    statistic: str
    value: float
    std_error: float | None
    rigs: int


def score_all(records: Iterable[Record]) -> tuple[StudyScore, ...]:
    """Return the scores of all conditions that have records."""
    by_condition: dict[str, list[Record]] = {}
    for record in sorted(records, key=lambda r: int(r["number"])):
        by_condition.setdefault(record["condition"], []).append(record)
    found: list[StudyScore] = []
    for name in (*CONDITIONS, ADVICE, MISTAKES):
        if name not in by_condition:
            continue
        failed = [r for r in by_condition[name] if "failed" in r]
        good = [r for r in by_condition[name] if "failed" not in r]
        found.append(StudyScore(name, "rigs", "", "failed", float(len(failed)), None, len(good)))
        if good:
            found += _SPECIAL.get(name, partial(_condition, name))(good)
    return tuple(found)


def _condition(name: str, records: Sequence[Record]) -> Iterator[StudyScore]:
    yield from _parameters(name, records)
    yield from _noise(name, records)
    for part in (INSIDE, BEYOND):
        yield from _depths(name, f"depth {part}", part, records)
        rash = [r for r in records if r["selected"] == SIMPLE]
        if CONDITIONS[name].model != SIMPLE and rash:
            yield from _depths(name, f"depth {part}{RASH}", part, rash)
    if len(CONDITIONS[name].fitted) > 1:
        yield from _selection(name, records)


def _mean(values: FloatArray) -> tuple[float, float | None]:
    """Return the mean and its standard error."""
    error = float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None
    return float(values.mean()), error


def _fraction(values: FloatArray) -> tuple[float, float | None]:
    """Return the mean of shares in 0 to 1 and its standard error.

    Where all are 0, or all 1, they have no scatter and the mean is uncertain all the same: the
    error is then that of two more rigs of either kind (Agresti and Coull 1998, doi
    10.1080/00031305.1998.10480550).
    """
    mean, error = _mean(values)
    if error == 0 and mean in (0.0, 1.0):
        count = len(values) + 4
        share = (mean * len(values) + 2) / count
        error = float(np.sqrt(share * (1 - share) / count))
    return mean, error


def _rms(values: FloatArray) -> tuple[float, float | None]:
    """Return the root mean square and its standard error."""
    square, error = _mean(values**2)
    root = float(np.sqrt(square))
    return root, None if error is None or root == 0 else error / (2 * root)


def _parameters(name: str, records: Sequence[Record]) -> Iterator[StudyScore]:
    known = [r["parameters"] for r in records if "parameters" in r]
    if not known:
        return
    for parameter, first in known[0].items():
        each = [k[parameter] for k in known]
        truth, bound, ideal = (
            np.array([e[key] for e in each]) for key in ("truth", "bound", "ideal")
        )
        clean = CONDITIONS[name].outlier_share == 0
        best = (ideal - truth) / bound if clean else None
        for estimator in ("linear", "bilinear", "robust", "posterior"):
            if estimator not in first:
                continue
            value = np.array([np.atleast_1d(e[estimator])[0] for e in each])
            miss = (value - truth) / bound
            for statistic, (mean, error) in (
                ("bias", _mean(miss)),
                ("efficiency", _efficiency(miss, best)),
            ):
                yield StudyScore(name, parameter, estimator, statistic, mean, error, len(each))
            if estimator in ("robust", "posterior"):
                yield from _pulls(name, parameter, estimator, each)
        ranks = np.array([e["posterior"][2] for e in each])
        yield from _coverage(name, parameter, "posterior", [[rank] for rank in ranks])
        yield _uniformity(name, parameter, ranks, tests=len(known[0]) + 1)


def _efficiency(miss: FloatArray, best: FloatArray | None) -> tuple[float, float | None]:
    """Return Cramer-Rao bound over mean square error, from misses in units of the bound.

    Parameters
    ----------
    best
        Misses of the estimate that attains the bound, on the same rows; None on rows with outliers,
        where it attains nothing: the bound itself, 1, then stands in its place.
    """
    attained = np.ones(len(miss)) if best is None else best**2
    square = float(np.mean(miss**2))
    ratio = float(np.mean(attained)) / square
    _, error = _mean((attained - ratio * miss**2) / square)
    return ratio, error


def _pulls(
    name: str, parameter: str, estimator: str, each: Sequence[Mapping[str, Any]]
) -> Iterator[StudyScore]:
    identified = [e for e in each if e["identified_by"] == "data"]
    if not identified:
        return
    pull = np.array([(e[estimator][0] - e["truth"]) / e[estimator][1] for e in identified])
    value, error = _rms(pull)
    yield StudyScore(name, parameter, estimator, "pull_rms", value, error, len(pull))


def _noise(name: str, records: Sequence[Record]) -> Iterator[StudyScore]:
    ranks = np.array([r[NOISE][3] for r in records])
    yield from _coverage(name, NOISE, "posterior", [[rank] for rank in ranks])
    tests = 1 + len(records[0].get("parameters", {}))
    yield _uniformity(name, NOISE, ranks, tests=tests)


def _coverage(
    name: str, subject: str, estimator: str, ranks: Sequence[Sequence[float]]
) -> Iterator[StudyScore]:
    """Yield how often central intervals hold the truth; rigs are independent, depths are not."""
    for level in LEVELS:
        hits = np.array([np.mean(np.abs(np.array(r) - 0.5) <= level / 2) for r in ranks if r])
        value, error = _fraction(hits)
        statistic = f"coverage{100 * level:.0f}"
        yield StudyScore(name, subject, estimator, statistic, value, error, len(hits))


def _uniformity(name: str, subject: str, ranks: FloatArray, *, tests: int) -> StudyScore:
    """Return the chi-squared p of uniform ranks, corrected for so many tests (Bonferroni)."""
    bins = int(np.clip(len(ranks) // RIGS_PER_BIN, 2, MOST_BINS))
    counts = np.histogram(ranks, bins=bins, range=(0, 1))[0]
    expected = len(ranks) / bins
    p = float(chi2.sf(((counts - expected) ** 2).sum() / expected, bins - 1))
    return StudyScore(
        name, subject, "posterior", "uniformity_p", min(1.0, p * tests), None, len(ranks)
    )


def _depths(name: str, subject: str, part: str, records: Sequence[Record]) -> Iterator[StudyScore]:
    for key, estimator, command in DEPTHS:
        depths = [r[key][part] for r in records if key in r]
        if not any(d["rank"] for d in depths):
            continue
        yield from _coverage(name, subject, estimator, [d["rank"] for d in depths])
        hits = np.array([np.mean(d["measure95"]) for d in depths if d["measure95"]])
        yield StudyScore(name, subject, command, "coverage95", *_fraction(hits), len(hits))
        widths = np.array([np.median(d["u_rel"]) for d in depths if d["u_rel"]])
        yield StudyScore(
            name, subject, estimator, "u_rel", float(np.median(widths)), None, len(widths)
        )
        biases = np.array(
            [np.mean(np.array(d["error_rel"]) / d["u_rel"]) for d in depths if d["u_rel"]],
            dtype=float,
        )
        yield StudyScore(name, subject, estimator, "bias", *_mean(biases), len(biases))


def _selection(name: str, records: Sequence[Record]) -> Iterator[StudyScore]:
    for model in CONDITIONS[name].fitted:
        chosen = np.array([float(r["selected"] == model) for r in records])
        yield StudyScore(name, "model", model, "share", *_fraction(chosen), len(chosen))
    clear = [
        r
        for r in records
        if "axis_z_mm" in r.get("parameters", {})
        and abs(r["parameters"]["axis_z_mm"]["truth"])
        > CLEAR_SIGMA * r["parameters"]["axis_z_mm"]["bound"]
    ]
    if clear:
        chosen = np.array([float(r["selected"] == EXTENDED) for r in clear])
        yield StudyScore(name, "model", EXTENDED, "share_clear", *_fraction(chosen), len(chosen))


def _mistakes(records: Sequence[Record]) -> list[StudyScore]:
    """Return how often the diagnosis names what is wrong, and how often where nothing is."""
    # Under each condition another rig.
    clean = [
        [bool(names)]
        for record in records
        for names in record["clean"].values()
        if names is not None
    ]
    found = [
        _share("clean rigs", "false_names", clean),
        _share(
            "clean rigs",
            "false_names_with_depths",
            [[bool(names) for names in record["clean_with_depths"]] for record in records],
        ),
    ]
    # Of each rig: rigs are independent of each other, what is done to one of them is not.
    made = [
        [one for one in record["mistakes"] if (one["effect"] or 0.0) > HARM] for record in records
    ]

    def share(statistic: str, subject: str, key: str, value: Any, says: Callable[[Any], bool],
              *, of: Callable[[Any], bool] = lambda _: True) -> StudyScore:  # fmt: skip
        some = [[says(one) for one in each if one[key] == value and of(one)] for each in made]
        return _share(subject, statistic, some)

    for rows in sorted({one["rows"] for each in made for one in each}):
        of_rows = partial(share, subject=f"{rows} rows", key="rows", value=rows)
        found += [
            of_rows("named", says=_is_named),
            of_rows("wrong_name", says=lambda one: bool(one["named"]) and not _is_named(one)),
            of_rows("in_evidence", says=_is_in_evidence),
            of_rows("named_in_evidence", says=_is_named, of=_is_in_evidence),
            of_rows("named_with_depths", says=_is_named_with_depths),
        ]
    for fault in dict.fromkeys(one["fault"] for each in made for one in each):
        found.append(share("named", fault, "fault", fault, _is_named))
    return found + _pairs(records)


def _pairs(records: Sequence[Record]) -> list[StudyScore]:
    """Return how often the diagnosis names one or both of two mistakes that were made at once."""
    made = [[one for one in r["pairs"] if (one["effect"] or 0.0) > HARM] for r in records]

    def right(one: Mapping[str, Any]) -> int:
        some = {*one["named"][:MOST_NAMED], *one["beside"][:MOST_NAMED]}
        return len(some & set(one["faults"]))

    def wrong(one: Mapping[str, Any]) -> bool:
        return bool(one["named"]) and right(one) == 0

    says: Mapping[str, Callable[[Mapping[str, Any]], bool]] = {
        "one_named": lambda one: right(one) > 0,
        "both_named": lambda one: right(one) > 1,
        "wrong_pair": wrong,
    }
    return [
        _share(
            f"{rows} rows, two mistakes",
            name,
            [[is_so(one) for one in each if one["rows"] == rows] for each in made],
        )
        for rows in sorted({one["rows"] for each in made for one in each})
        for name, is_so in says.items()
    ]


def _is_named(one: Mapping[str, Any]) -> bool:
    return one["fault"] in one["named"][:MOST_NAMED]


def _is_named_with_depths(one: Mapping[str, Any]) -> bool:
    return one["fault"] in (one["with_depths"] or ())


def _is_in_evidence(one: Mapping[str, Any]) -> bool:
    return one["gain"] is not None and one["gain"] + PENALTY > EVIDENT


def _share(subject: str, statistic: str, held: Sequence[Sequence[bool]]) -> StudyScore:
    """Return a share of the cases of all rigs, those of one rig in a list.

    The standard error is that of a ratio of sums over rigs, whose cases go together (Cochran 1977,
    Sampling Techniques, 2.11).
    """
    counts = np.array([len(each) for each in held if each], dtype=float)
    hits = np.array([sum(each) for each in held if each], dtype=float)
    rigs = len(counts)
    if rigs == 0:
        return StudyScore(MISTAKES, subject, "", statistic, float("nan"), None, 0)
    share = float(hits.sum() / counts.sum())
    if share in (0.0, 1.0):
        _, error = _fraction(np.full(rigs, share))
    else:
        _, spread = _mean(hits - share * counts)
        error = None if spread is None else spread / float(counts.mean())
    return StudyScore(MISTAKES, subject, "", statistic, share, error, rigs)


def _advice(records: Sequence[Record]) -> list[StudyScore]:
    """Return how much lower u(z) is after advised than after random targets."""
    found = []
    for criterion in records[0]["u_rel"]:
        if criterion == "random":
            continue
        ratio = np.array([r["u_rel"][criterion] / r["u_rel"]["random"] for r in records])
        spread = np.diff(np.quantile(ratio, [0.25, 0.75]))[0]
        # Standard error of a median, from the quartiles of a normal sample.
        error = float(1.2533 * spread / 1.349 / np.sqrt(len(ratio)))
        found.append(
            StudyScore(ADVICE, "depth asked", criterion, "u_ratio", float(np.median(ratio)), error,
                  len(ratio))
        )  # fmt: skip
    return found


_SPECIAL: Mapping[str, Callable[[Sequence[Record]], Iterable[StudyScore]]] = MappingProxyType(
    {ADVICE: _advice, MISTAKES: _mistakes}
)
"""Scores of trials that are no calibrations of one rig under one condition."""
