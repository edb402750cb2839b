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
from calib.results.published import contradictions


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


def test_contradictions_are_told_in_one_line_and_agreement_is_not() -> None:
    calibration, _ = everything()
    lens = calibration.images.intrinsics["c1"]
    value, u = float(lens.camera.matrix[0, 0]), float(np.sqrt(lens.covariance[0, 0]))
    known = {"c1.fx": (value - 4 * np.hypot(u, 0.5), 0.5), "c1.cx": (lens.camera.matrix[0, 2], 1.0)}
    (told,) = contradictions(calibration.images, known)
    assert "c1.fx" in told
    assert "(+4.0)" in told
    assert "c1.cx" not in told
    assert list(contradictions(calibration.images, {"c1.cx": known["c1.cx"]})) == []


def test_nothing_published_nothing_written() -> None:
    calibration, context = everything()
    assert published(calibration, replace(context, published={})) is None


def test_unknown_quantity_is_refused_with_the_nearest(tmp_path: Path) -> None:
    """Negative control: a slip in the name."""
    manifest = 'format = 1\nname = "x"\n[published]\n"c1.fz" = [500.0, 1.0]\n'
    (tmp_path / "dataset.toml").write_text(manifest)
    with pytest.raises(InputError, match=r"c1\.fx|c1\.fy"):
        load_dataset(tmp_path)
