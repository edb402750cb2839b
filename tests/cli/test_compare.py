"""calib compare. Evidence: properties, published test statistics, negative controls."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calib.__main__ import main
from calib.drift import compare_runs
from calib.errors import InputError, UsageError
from calib.report.drift_page import drift_page, drift_text


def run_file(
    folder: Path, *, baseline: float, delta2: float = 0.013, selected: str = "base"
) -> Path:
    """Write a calibration.json with a baseline known to 0.5 mm and a zero known to 0.4 mrad."""
    folder.mkdir()
    names = ["baseline_mm", "delta2_rad", "log_noise_scale"]
    covariance = np.diag([0.5**2, 4e-4**2, 0.1])
    covariance[0, 1] = covariance[1, 0] = 0.3 * 0.5 * 4e-4
    values = dict(zip(names, (baseline, delta2, 0.0), strict=True))
    document = {
        "format": 1,
        "dataset": {"name": "<b>rig</b>", "sha256": "0"},
        "fits": {
            "base/posterior": {
                "names": names,
                "covariance": covariance.tolist(),
                "parameters": {n: {"value": v, "std": 1.0} for n, v in values.items()},
            }
        },
        "selected": selected,
        "depth_uncertainty": [{"z_mm": 500.0, "u_mm": 2.0}],
        "comparison": [{"model": "base", "loo": 20.0}],
        "gates": [{"name": "fit", "passed": True}],
    }
    (folder / "calibration.json").write_text(json.dumps(document))
    return folder


def test_a_change_is_told_from_none(tmp_path: Path) -> None:
    first = run_file(tmp_path / "a", baseline=77.0)
    same = run_file(tmp_path / "b", baseline=77.6)
    moved = run_file(tmp_path / "c", baseline=81.0)
    drift = compare_runs([first, same, moved])
    changes = {(Path(c.run).name, c.name): c for c in drift.changes}
    # Differences over hypot(0.5, 0.5) mm.
    assert changes["b", "baseline_mm"].sigmas == pytest.approx(0.6 / 0.7071, rel=1e-3)
    assert not changes["b", "baseline_mm"].significant
    assert changes["c", "baseline_mm"].significant
    assert not changes["c", "delta2_rad"].significant
    assert drift.joint[0] > 0.5
    assert drift.joint[1] < 1e-5


def test_joint_probability_against_the_closed_form(tmp_path: Path) -> None:
    """Two parameters: chi squared with 2 degrees of freedom is exp(-d² / 2)."""
    drift = compare_runs(
        [
            run_file(tmp_path / "a", baseline=77.0),
            run_file(tmp_path / "b", baseline=78.0, delta2=0.0135),
        ]
    )
    covariance = 2 * np.array([[0.25, 0.3 * 0.5 * 4e-4], [0.3 * 0.5 * 4e-4, 1.6e-7]])
    change = np.array([1.0, 5e-4])
    distance = change @ np.linalg.inv(covariance) @ change
    assert drift.joint[0] == pytest.approx(np.exp(-distance / 2), rel=1e-6)


def test_false_alarms_keep_to_the_family_risk(tmp_path: Path) -> None:
    """Repeated simulation: of runs of an unchanged rig about 5 % raise any alarm, at most."""
    rng = np.random.default_rng(0)
    alarms = 0
    for i in range(200):
        folders = [
            run_file(tmp_path / f"{i}-{k}", baseline=77 + 0.5 * z[0], delta2=0.013 + 4e-4 * z[1])
            for k, z in enumerate(rng.multivariate_normal([0, 0], [[1, 0.3], [0.3, 1]], 2))
        ]
        alarms += any(change.significant for change in compare_runs(folders).changes)
    # Binomial with 200 and 0.05: above 21 once in a thousand.
    assert alarms <= 21


def test_text_and_page(tmp_path: Path) -> None:
    drift = compare_runs(
        [run_file(tmp_path / "a", baseline=77.0), run_file(tmp_path / "b", baseline=81.0)]
    )
    assert "SIGNIFICANT" in drift_text(drift)
    page = drift_page(drift)
    assert "<b>rig</b>" not in page
    assert "&lt;b&gt;rig&lt;/b&gt;" in page
    assert 'src="http' not in page


def test_command_writes_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = [str(run_file(tmp_path / n, baseline=77.0)) for n in "ab"]
    assert main(["compare", *runs, "--out", str(tmp_path / "page.html")]) == 0
    assert "baseline_mm" in capsys.readouterr().out
    assert (tmp_path / "page.html").read_text().startswith("<!DOCTYPE html>")


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    good = run_file(tmp_path / "a", baseline=77.0)
    with pytest.raises(UsageError, match="two runs"):
        compare_runs([good])
    bad = tmp_path / "bad"
    bad.mkdir()
    (bad / "calibration.json").write_text('{"format": 2}')
    with pytest.raises(InputError, match="format") as caught:
        compare_runs([good, bad, tmp_path / "missing"])
    assert len(caught.value.problems) == 2
