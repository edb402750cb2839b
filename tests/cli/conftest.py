"""A file with the calibration written by hand."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from given_calibration import calibration


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(calibration()))
    return path
