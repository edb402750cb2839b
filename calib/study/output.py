"""What a study writes: scores.csv, scores.json and figures."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from functools import partial
from typing import Any

import numpy as np

from calib.core.version import __version__
from calib.study.claims import Verdict
from calib.study.conditions import GROUPS
from calib.study.figures import FIGURES, ranks, styled
from calib.study.scores import NOISE, StudyScore

Record = dict[str, Any]

DIGITS = 4
"""Significant digits in the table: far more than so many rigs support."""


TABLE, DOCUMENT, RANKS = "scores.csv", "scores.json", "ranks.svg"


def study_names() -> tuple[str, ...]:
    """Return the names of all files that a study may write."""
    return TABLE, DOCUMENT, RANKS, *(f"{name}.svg" for name in FIGURES)


def study_files(
    records: Sequence[Record],
    scores: Sequence[StudyScore],
    verdicts: Sequence[Verdict],
    *,
    settings: Mapping[str, Any],
    mark: bytes = b"",
) -> dict[str, bytes]:
    """Return table and figures by the names of their files.

    Parameters
    ----------
    settings
        Command, seed and number of rigs, for scores.json.
    mark
        Attribute by which a figure is known for one of a study.
    """
    document = {
        "generator": f"calib {__version__}",
        "settings": dict(settings),
        "claims": [asdict(verdict) for verdict in verdicts],
        "scores": [asdict(score) for score in scores],
    }
    text = json.dumps(document, indent=1, allow_nan=False, default=str) + "\n"
    figures = {RANKS: styled(lambda: ranks(_ranks(records)))}
    for name, draw in FIGURES.items():
        figures[f"{name}.svg"] = styled(partial(draw, scores))
    tables = {TABLE: table(scores).encode(), DOCUMENT: text.encode()}
    return tables | {
        name: picture.replace(b"<svg ", b"<svg " + mark, 1)
        for name, picture in figures.items()
        if picture is not None
    }


def table(scores: Sequence[StudyScore]) -> str:
    """Return the scores as CSV, one line each."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([field.name for field in fields(StudyScore)])
    for score in scores:
        writer.writerow([_cell(value) for value in asdict(score).values()])
    return buffer.getvalue()


def _cell(value: object) -> object:
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}"
    return "" if value is None else value


def _ranks(records: Sequence[Record]) -> dict[str, dict[str, np.ndarray]]:
    """Return the ranks of the truth by condition and parameter, for the rank conditions."""
    found: dict[str, dict[str, list[float]]] = {}
    for record in records:
        if record["condition"] not in GROUPS["ranks"] or "failed" in record:
            continue
        one = found.setdefault(record["condition"], {})
        for name, parameter in record["parameters"].items():
            one.setdefault(name, []).append(parameter["posterior"][2])
        one.setdefault(NOISE, []).append(record[NOISE][3])
    return {c: {n: np.array(r) for n, r in one.items()} for c, one in found.items()}
