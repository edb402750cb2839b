"""`z_from`: what it makes of depths and priors. Evidence: closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.core.errors import InputError
from calib.dataset.contents import Dataset
from calib.dataset.load import load_dataset
from calib.geometry.parameters import REFERENCE_OFFSET, vector
from calib.rows.from_table import (
    Setup,
    observe,
    observe_validation,
    row_priors,
    row_settings,
    validation_settings,
)

ROWS = """id,x1c,y1c,alpha2_deg,z_mm
1,0.10,0.01,86.15,485.9
2,0.26,0.02,95.01,486.5
3,0.24,0.01,96.95,796.4
4,0.02,0.03,85.21,805.9
5,0.02,0.01,85.86,1008.5
6,0.16,0.01,94.03,998.5
"""


def dataset(folder: Path, gaze: str = "", validation: str = "") -> Dataset:
    folder.mkdir(exist_ok=True)
    (folder / "gaze.csv").write_text(ROWS)
    (folder / "dataset.toml").write_text(
        'format = 1\nname = "x"\n[encoder]\nresolution_deg = 0.05\n'
        f'[gaze]\ntable = "gaze.csv"\nu_x1c = 0.0002\nu_z_mm = 1.0\n{gaze}\n'
        f'[validation]\ntable = "gaze.csv"\nu_z_mm = 3.0\n{validation}\n'
    )
    return load_dataset(folder)


AHEAD = "z_from = { ahead_of_c1_mm = 35.0, u_mm = 2.0 }"


@pytest.mark.parametrize(
    ("stated", "ahead", "prior"),
    [
        ("", 0.0, 50.0),
        ('z_from = "c1"', 0.0, None),
        ('reference = "stereovision"', 0.0, None),
        ('reference = "laser meter"', 0.0, 50.0),
        (AHEAD, 35.0, 2.0),
        (AHEAD + '\nreference = "stereovision"', 35.0, 2.0),
    ],
)
def test_the_manifest_moves_depths_and_opens_the_offset(
    tmp_path: Path, stated: str, ahead: float, prior: float | None
) -> None:
    found = dataset(tmp_path / "d", stated)
    assert found.gaze is not None
    rows = observe(found.gaze, Setup(row_settings(found)), None)
    np.testing.assert_array_equal(rows.z_mm, found.gaze.z_mm + ahead)
    expected = {} if prior is None else {REFERENCE_OFFSET: (0.0, prior)}
    assert row_priors(found) == expected
    assert any("from where z_mm counts" in warning for warning in found.warnings) == (prior == 50.0)


def test_validation_counts_from_the_same_place_unless_stated(tmp_path: Path) -> None:
    theta = vector({"baseline_mm": 80.0, REFERENCE_OFFSET: 24.0})
    silent = dataset(tmp_path / "silent")
    assert silent.validation is not None
    z = silent.validation.z_mm
    rows = observe_validation(silent.validation, Setup(validation_settings(silent)), None)
    np.testing.assert_array_equal(rows.depth_from_c1(theta), z + 24.0)
    stated = dataset(tmp_path / "stated", validation="z_from = { ahead_of_c1_mm = 9, u_mm = 4 }")
    assert stated.validation is not None
    setup = Setup(validation_settings(stated))
    own = observe_validation(stated.validation, setup, None, own_origin=True)
    np.testing.assert_array_equal(own.depth_from_c1(theta), z + 9.0)
    np.testing.assert_allclose(own.rows.std[:, -1], 5.0, rtol=1e-12)


def test_no_prior_speaks_beside_z_from(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown parameter"):
        dataset(tmp_path / "d", "[priors]\nreference_offset_mm = [0, 5]")
