"""Every place of a calibration.json tampered with: refused, in one line that names the file.

Evidence: property, over all places of the file of a real run. First as an editor would do it, whom
the file's digest gives away; then by somebody who computes the digest anew, whom the types and
ranges stop as far as they can.
"""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel
from short_chain import dataset, shorten

from calib.cli.main import main
from calib.core.seal import KEY, with_digest
from calib.document.reading import MeasuringFile

Place = tuple[str | int, ...]

FEW = 2
"""Entries of a list that are tried, from both ends: the others are of the same kind."""

DROP = object()

NUMBERS: dict[str, Any] = {
    "text": "1.0", "list": [1.0], "object": {"value": 1.0}, "truth": True, "none": None,
    "no number": math.nan, "no end": math.inf,
}  # fmt: skip
"""What a number must not become."""

OTHERS: dict[str, Any] = {"number": 7.5, "none": None, "truth": False}
"""What text, lists and objects must not become."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the document of a finished run."""
    top = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch.setattr)
        main(["calibrate", str(dataset(top / "data")), "--out", str(top / "run")])
    document: dict[str, Any] = json.loads((top / "run" / "calibration.json").read_text())
    return document


def places(value: Any, at: Place = ()) -> Iterator[Place]:
    """Yield every place of a document, of long lists some."""
    if at:
        yield at
    if isinstance(value, dict):
        for key, item in value.items():
            yield from places(item, (*at, key))
    elif isinstance(value, list):
        for i in sorted({*range(len(value))[:FEW], *range(len(value))[-FEW:]}):
            yield from places(value[i], (*at, i))


def value_at(document: Any, place: Place) -> Any:
    for key in place:
        document = document[key]
    return document


def changed(document: dict[str, Any], place: Place, value: Any) -> dict[str, Any]:
    """Return a copy with one value replaced, or taken out."""
    found = copy.deepcopy(document)
    at = value_at(found, place[:-1])
    if value is DROP:
        del at[place[-1]]
    else:
        at[place[-1]] = value
    return found


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def edits(value: Any) -> Iterator[Any]:
    """Yield what an editor may make of a value."""
    yield DROP
    if is_number(value):
        yield from (value * 1.1 + 1e-3, -value - 1e-3, *NUMBERS.values())
    elif isinstance(value, list) and len(value) > 1 and value[0] != value[-1]:
        yield [value[-1], *value[1:-1], value[0]]
    elif isinstance(value, str):
        yield value + "x"


@pytest.fixture
def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Give a function that returns why a document is refused, in its one line."""
    file, table = tmp_path / "calibration.json", tmp_path / "t.csv"
    table.write_text("id,x1c,y1c,alpha2_deg\na,0.05,0,86.2\n")

    def why(document: dict[str, Any], what: object) -> str:
        file.write_text(json.dumps(document))
        status = main(["measure", str(file), str(table)])
        said = capsys.readouterr()
        assert status == 2, f"{what}: taken, {said.out}"
        assert said.out == "", what
        assert said.err.count("\n") == 1, f"{what}: {said.err}"
        assert str(file) in said.err, f"{what}: {said.err}"
        assert "Traceback" not in said.err, what
        return said.err

    return why


@pytest.mark.slow
def test_no_edit_passes(whole: dict[str, Any], refused: Callable[..., str]) -> None:
    tried = 0
    for place in places(whole):
        if place == ("generator",) or (
            len(place) > 4 and place[0] not in ("measurement", "stereo")
        ):
            continue
        for value in edits(value_at(whole, place)):
            refused(changed(whole, place, value), (place, value))
            tried += 1
    assert tried > 2000


def read_by_measure(
    model: type[BaseModel], at: Place, document: Any
) -> Iterator[tuple[Place, bool]]:
    """Yield the places that measuring reads, and whether one must be there."""
    for name, field in model.model_fields.items():
        if not isinstance(document, dict) or name not in document:
            continue
        yield (*at, name), field.is_required()
        kinds = [k for k in (field.annotation, *get_args(field.annotation)) if isinstance(k, type)]
        inner = next((k for k in kinds if issubclass(k, BaseModel)), None)
        if inner is None:
            continue
        value = document[name]
        if isinstance(value, list):
            for i in range(min(len(value), FEW)):
                yield from read_by_measure(inner, (*at, name, i), value[i])
        elif (isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)) or (
            value is not None and name not in ("intrinsics",)
        ):
            yield from read_by_measure(inner, (*at, name), value)


RANGES: dict[str, tuple[Place, Any]] = {
    "a negative variance": (("measurement", "covariance", 0, 0), -1.0),
    "not symmetric": (("measurement", "covariance", 0, 1), 1e3),
    "no noise": (("measurement", "noise_factor"), 0.0),
    "negative noise": (("measurement", "noise_factor"), -1.0),
    "no coverage": (("measurement", "factor95"), 0.0),
    "depths exchanged": (("measurement", "calibrated_depth_mm"), [1000.0, 500.0]),
    "a depth behind": (("measurement", "calibrated_depth_mm"), [-500.0, 1000.0]),
    "a negative spread": (("measurement", "reading", "x1c", "normal"), -1e-4),
    "a negative width": (("measurement", "reading", "alpha2_rad", "width"), -1e-4),
    "negative stated": (("measurement", "stated", "u_x1c"), -1e-4),
    "format 2": (("format",), 2),
    "format 0": (("format",), 0),
}


def wrong_types(whole: dict[str, Any]) -> Iterator[tuple[Place, Any]]:
    """Yield places that measuring reads, with what cannot stand there."""
    for place, is_required in read_by_measure(MeasuringFile, (), whole):
        if is_required:
            yield place, DROP
        was = value_at(whole, place)
        for value in OTHERS.values():
            is_absent = value is None and not is_required
            if not (is_absent or is_number(was) or (value is False and isinstance(was, bool))):
                yield place, value


def wrong_values(whole: dict[str, Any]) -> Iterator[tuple[Place, Any]]:
    """Yield places of what measuring needs, with values that are none or out of range."""
    for place in places(whole["measurement"], ("measurement",)):
        if is_number(value_at(whole, place)):
            yield from ((place, value) for value in NUMBERS.values())
    yield from RANGES.values()
    names = whole["measurement"]["names"]
    for wrong in ([names[0]] * len(names), names[:-1], [*names[:-1], "depth_mm"], [*names, "x"]):
        yield ("measurement", "names"), wrong


@pytest.mark.slow
def test_no_impossible_value_passes_under_a_digest_of_its_own(
    whole: dict[str, Any], refused: Callable[..., str]
) -> None:
    tried = 0
    for place, value in (*wrong_types(whole), *wrong_values(whole)):
        tampered = changed({k: v for k, v in whole.items() if k != KEY}, place, value)
        with suppress(ValueError):  # no JSON has NaN or infinity, nor a digest
            tampered = with_digest(tampered)
        refused(tampered, (place, value))
        tried += 1
    assert tried > 500
