"""JSON Schemas.

Evidence: an independent validator (jsonschema) holds real files against them, and refuses damaged.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from command import call

from calib.cli.main import main
from calib.document.calibration import Document
from tests.reliability.short_chain import dataset, shorten

PROJECT = Path(__file__).parents[2]


def schema_of(file: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    ended = call(capsys, "schema", file)
    assert (ended.status, ended.err) == (0, "")
    found: dict[str, Any] = json.loads(ended.out)
    jsonschema.Draft202012Validator.check_schema(found)
    return found


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    top = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch.setattr)
        main(["calibrate", str(dataset(top / "data")), "--out", str(top / "out")])
    found: dict[str, Any] = json.loads((top / "out" / "calibration.json").read_text())
    return found


def test_a_calibration_is_as_its_schema_says(
    document: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    schema = schema_of("calibration", capsys)
    jsonschema.validate(document, schema)
    Document.model_validate_json(json.dumps(document))
    for key in document:
        assert key in schema["properties"]
    for change in ({"extra": 1}, {"gates": None}, {"seed": "0"}, {"format": 2}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(document | change, schema)


def test_datasets_are_as_their_schema_says(capsys: pytest.CaptureFixture[str]) -> None:
    schema = schema_of("dataset", capsys)
    manifest = tomllib.loads((PROJECT / "datasets/xu-wang-2017/dataset.toml").read_text())
    jsonschema.validate(manifest, schema)
    for change in ({"fromat": 1}, {"format": 3}, {"encoder": {"resolution": 1}}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(manifest | change, schema)


def test_a_rig_is_as_its_schema_says(capsys: pytest.CaptureFixture[str]) -> None:
    schema = schema_of("rig", capsys)
    page = (PROJECT / "docs/rig.md").read_text()
    rig = tomllib.loads(page.split("```toml\n")[1].split("```")[0])
    jsonschema.validate(rig, schema)
    for change in ({"serail": "7"}, {"format": 2}, {"axis": {"driver": "virtual"}}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(rig | change, schema)
