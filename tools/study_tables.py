#!/usr/bin/env python3
"""Writes the tables of docs/uncertainty.md from the studies committed in docs/study.

Usage: tools/study_tables.py [--check]

A table stands between `<!-- study NAME -->` and `<!-- end -->`; what is between is replaced. With
--check nothing is written and the status is 1 if a table is not that of the study.
"""

from __future__ import annotations

import csv
import json
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from calib.simulate.faults import FAULTS
from calib.study.conditions import CONDITIONS, GROUPS, MISTAKES
from calib.study.faults import ROW_COUNTS
from calib.study.scores import RASH

DOCS = Path(__file__).parents[1] / "docs"
DOCUMENT = DOCS / "uncertainty.md"
TABLE = re.compile(r"(<!-- study (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)

ASSUMPTIONS = (
    ("quantisation is normal", "an encoder coarser than all other errors, 6 rows", "coarse-6"),
    ("", "the same, 14 rows", "coarse-14"),
    ("uncertainties are right", "stated at half", "stated-half"),
    ("", "stated at twice", "stated-double"),
    ("priors are right", "stated at a third", "prior-third"),
    ("", "stated at three times", "prior-triple"),
    ("reference depths scatter as stated", "1 % each, stated", "reference-rough"),
    ("they have no common error", "0.5 % in common, stated", "reference-shared"),
    ("", "0.5 % in common, not stated", "reference-hidden"),
    ("the model has the rig's form", "encoder errors, not modelled", "encoder-bent"),
    ("", "tilted axes, not modelled", "axis-tilted"),
)
"""What is assumed, how it is broken, and the condition that does."""

Key = tuple[str, str, str, str]


class Study:
    """The scores of one study."""

    def __init__(self, folder: Path) -> None:
        with (folder / "scores.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        names = ("condition", "subject", "estimator", "statistic")
        self._rows = {tuple(row[name] for name in names): row for row in rows}
        self.document: dict[str, Any] = json.loads((folder / "scores.json").read_text())

    def conditions(self, group: str) -> list[str]:
        """Return the conditions of a group that were studied."""
        known = {key[0] for key in self._rows}
        return [name for name in GROUPS[group] if name in known]

    def value(self, *key: str, unit: float = 1.0, digits: int = 2) -> str:
        """Return a score with its standard error, or nothing."""
        row = self._rows.get(key)
        if row is None:
            return ""
        value = f"{unit * float(row['value']):.{digits}f}"
        if not row["std_error"]:
            return value
        return f"{value} ± {unit * float(row['std_error']):.{digits}f}"

    def percent(self, *key: str, digits: int = 1) -> str:
        """Return a score in per cent, or nothing."""
        text = self.value(*key, unit=100, digits=digits)
        return f"{text} %" if text else ""

    def rigs(self, *key: str) -> int:
        """Return how many rigs a score is from, 0 without one."""
        row = self._rows.get(key)
        return 0 if row is None else int(row["rigs"])


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join(f"| {' | '.join(line)} |\n".replace("|  |", "| |") for line in lines)


def _depths(study: Study, name: str) -> list[str]:
    cells = []
    for who in ("selected", "averaged"):
        cells += [
            study.percent(name, f"depth {part}", who, "coverage95") for part in ("inside", "beyond")
        ]
        cells.append(study.percent(name, "depth inside", who, "u_rel", digits=2))
    return cells


DEPTH_HEADS = ("inside", "to 1.5 times", "u(z)/z", "averaged: inside", "to 1.5 times", "u(z)/z")


def expected() -> str:
    """Return the table of rigs as the method expects them."""
    study = Study(DOCS / "study" / "default")
    rows = []
    for name in study.conditions("default"):
        condition = CONDITIONS[name]
        kind = condition.model + (", 10 % gross errors" if condition.outlier_share else "")
        rows.append([kind, str(condition.rows), *_depths(study, name)])
    return _table(("rigs", "rows", *DEPTH_HEADS), rows)


def doubtful() -> str:
    """Return the table of rigs with an axis offset on which `base` was selected."""
    rows = []
    for folder in ("default", "broken"):
        study = Study(DOCS / "study" / folder)
        for name in study.conditions(folder):
            inside, beyond = (f"depth {part}{RASH}" for part in ("inside", "beyond"))
            count = study.rigs(name, inside, "averaged", "coverage95")
            if count < LEAST_RIGS:
                continue
            cells = [
                study.percent(name, subject, who, "coverage95")
                for who in ("selected", "averaged")
                for subject in (inside, beyond)
            ]
            rows.append([CONDITIONS[name].meaning, str(count), *cells])
    heads = ("rigs", "with `base`", "inside", "to 1.5 times", "averaged: inside", "to 1.5 times")
    return _table(heads, rows)


LEAST_RIGS = 20
"""Of fewer rigs a coverage says nothing."""


def broken() -> str:
    """Return the table of broken assumptions."""
    study = Study(DOCS / "study" / "broken")
    rows = [[what, how, *_depths(study, name)] for what, how, name in ASSUMPTIONS]
    return _table(("assumption", "broken by", *DEPTH_HEADS), rows)


def claims(folder: str = "default") -> str:
    """Return the table of a study's claims with the worst score of each."""
    rows = []
    for claim in Study(DOCS / "study" / folder).document["claims"]:
        worst = claim["worst"]
        error = "" if worst["std_error"] is None else f" ± {worst['std_error']:.2g}"
        verdict = "held" if claim["held"] else "broken" if claim["broken"] else "open"
        where = ", ".join(part for part in (worst["condition"], worst["subject"]) if part)
        rows.append([claim["claim"], f"{worst['value']:.3g}{error}", where, verdict])
    return _table(("claim", "worst score", "of", "verdict"), rows)


def efficiency() -> str:
    """Return the efficiency of the estimators on 60 clean rows."""
    study = Study(DOCS / "study" / "default")
    rows = []
    for name, parameters in (
        ("base-60", ("baseline_mm", "delta2_rad")),
        ("axis-offset-60", ("baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm")),
    ):
        for parameter in parameters:
            cells = [
                study.value(name, parameter, who, "efficiency")
                for who in ("robust", "posterior", "linear")
            ]
            rows.append([CONDITIONS[name].model, f"`{parameter}`", *cells])
    return _table(("rigs", "parameter", "robust fit", "posterior mean", "linear fit"), rows)


def mistakes() -> str:
    """Return the table of mistakes that matter, by the number of rows."""
    study = Study(DOCS / "study" / "faults")
    rows = []
    for count in ROW_COUNTS:
        subject = f"{count} rows"
        shares = ("named", "wrong_name", "in_evidence", "named_in_evidence", "named_with_depths")
        cells = [study.percent(MISTAKES, subject, "", share, digits=0) for share in shares]
        rows.append([str(count), str(study.rigs(MISTAKES, subject, "", "named")), *cells])
    heads = ("rows", "rigs", "named", "wrong name", "in evidence",
             "named, of those in evidence", "named with six depths more")  # fmt: skip
    return _table(heads, rows)


def by_mistake() -> str:
    """Return the table of mistakes that matter, by their names, and of rigs without one."""
    study = Study(DOCS / "study" / "faults")
    rows = []
    for fault in FAULTS:
        key = (MISTAKES, fault, "", "named")
        if study.rigs(*key):
            rows.append([f"`{fault}`", str(study.rigs(*key)), study.percent(*key, digits=0)])
    clean = "clean rigs"
    rows.append([
        "none made, any named",
        str(study.rigs(MISTAKES, clean, "", "false_names")),
        study.percent(MISTAKES, clean, "", "false_names"),
    ])  # fmt: skip
    return _table(("mistake", "rigs", "named"), rows)


TABLES: dict[str, Callable[[], str]] = {
    "expected": expected,
    "doubtful": doubtful,
    "broken": broken,
    "claims": claims,
    "efficiency": efficiency,
    "mistakes": mistakes,
    "by_mistake": by_mistake,
    "mistake_claims": lambda: claims("faults"),
}


def filled(text: str) -> str:
    """Return a document with its tables made anew."""
    return TABLE.sub(lambda found: found[1] + TABLES[found[2]]() + found[3], text)


def main(arguments: Sequence[str]) -> int:
    """Write the tables, or check them."""
    text = DOCUMENT.read_text(encoding="utf-8")
    made = filled(text)
    if "--check" in arguments:
        return int(made != text)
    DOCUMENT.write_text(made, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
