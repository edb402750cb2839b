"""Published values beside those found. Evidence: closed form, negative control."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_examples import everything

from calib.core.errors import InputError
from calib.dataset.load import load_dataset
from calib.geometry.poses import invert_pose
from calib.report.sections.published import published


def test_differences_in_units_of_their_uncertainty() -> None:
    """Closed form: (found - published) / hypot of both standard uncertainties."""
    calibration, context = everything()
    stereo = calibration.images.stereo
    assert stereo is not None
    pose, covariance = invert_pose(stereo.pose_12, stereo.covariance)
    value, u = float(pose[3]), float(np.sqrt(covariance[3, 3]))
    known = {"c1_in_c2.translation_x_mm": (value - 5 * np.hypot(u, 0.1), 0.1)}
    section = published(calibration, replace(context, published=known))
    assert section is not None
    (row,) = section.blocks[-1].rows
    assert row[-1].text == "+5.0"
    assert row[-1].mark == "bad"


def test_nothing_published_nothing_written() -> None:
    calibration, context = everything()
    assert published(calibration, replace(context, published={})) is None


def test_unknown_quantity_is_refused_with_the_nearest(tmp_path: Path) -> None:
    """Negative control: a slip in the name."""
    manifest = 'format = 1\nname = "x"\n[published]\n"c1.fz" = [500.0, 1.0]\n'
    (tmp_path / "dataset.toml").write_text(manifest)
    with pytest.raises(InputError, match=r"c1\.fx|c1\.fy"):
        load_dataset(tmp_path)
