"""calibration.json is never written so that it could not be read back.

Evidence: results spoilt on purpose. A run that went so far keeps its report, whose gates say more.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.core.errors import InputError
from calib.core.gate import Gate
from calib.instrument.calibration_file import read_calibration
from calib.results.calibration import Calibration, GazeResult
from calib.results.contents.whole import to_json
from tests.report.report_examples import paper


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    found, _ = paper()
    return found


def spoilt(calibration: Calibration, *, variance: float) -> Calibration:
    """Return it with another first variance of the instrument of record."""
    gaze = calibration.gaze
    assert isinstance(gaze, GazeResult)
    assert gaze.calibrated is not None
    known = gaze.calibrated.instrument.parameters
    covariance = np.array(known.covariance)
    covariance[0, 0] = variance
    instrument = replace(
        gaze.calibrated.instrument, parameters=replace(known, covariance=covariance)
    )
    calibrated = replace(gaze.calibrated, instrument=instrument)
    return replace(calibration, gaze=replace(gaze, calibrated=calibrated))


def test_a_sound_one_is_read_back(calibration: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(to_json(calibration))
    gaze = calibration.gaze
    assert gaze is not None
    assert gaze.calibrated is not None
    found = read_calibration(path).instrument.parameters
    stated = gaze.calibrated.instrument.parameters
    assert found.names == stated.names
    np.testing.assert_allclose(found.covariance, stated.covariance, rtol=1e-11)


@pytest.mark.parametrize("variance", [np.nan, np.inf, -1.0])
def test_an_instrument_that_cannot_be_is_left_out_with_the_reason(
    calibration: Calibration, tmp_path: Path, variance: float
) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(to_json(spoilt(calibration, variance=variance)))
    document = json.loads(path.read_text())
    assert "measurement" not in document
    assert document["not_fitted"]["measurement"]
    with pytest.raises(InputError, match="holds no gaze calibration"):
        read_calibration(path)


def test_a_check_by_numpy_ends_no_run(calibration: Calibration) -> None:
    gate = Gate("depth", passed=np.float64(1) < 2, detail="")
    document = json.loads(to_json(replace(calibration, gates=(gate,))))
    assert document["gates"] == [{"name": "depth", "passed": True, "detail": ""}]
