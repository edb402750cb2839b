"""Drift between runs. Evidence: simulated changes of known size, repeated draws, properties."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.cli.compare import add_arguments, run
from calib.core.errors import UsageError
from calib.dataset.tables import GazeTable
from calib.history.drift import FAMILY_RISK, ComparedRun, drift
from calib.history.output import html, tables, text
from calib.instrument.calibration_file import Measuring
from calib.rows.common_errors import CommonErrors
from calib.rows.from_table import CameraSet, RowSettings, Setup
from calib.rows.sketch import sketch
from calib.uncertainty.measurement import Instrument, ParameterKnowledge, ReadingSpread

NAMES = ("baseline_mm", "delta2_rad", "axis_z_mm", "eccentricity_mm")
TRUTH = np.array([120.0, 0.01, -20.0, 3.0])
# L_b and e as gaze rows leave them: correlation -0.998, their sum known to 0.4 mm.
STD = np.array([6.0, 5e-4, 1.0, 6.0])
CORRELATION = np.eye(4)
CORRELATION[0, 3] = CORRELATION[3, 0] = -0.998
COVARIANCE = CORRELATION * np.outer(STD, STD)


def made(values: np.ndarray, name: str = "run", model: str = "axis-offset") -> ComparedRun:
    knowledge = ParameterKnowledge(NAMES, values, COVARIANCE, None, ("A",) * 4)
    measuring = Measuring(
        instrument=Instrument(knowledge, ReadingSpread()),
        setup=Setup(RowSettings(0, 0, 0, 0, 0), CameraSet(), CommonErrors()),
        noise_factor=1.0,
        calibrated_mm=(600.0, 1400.0),
        factor95=1.96,
    )
    return ComparedRun(name, "rig", model, measuring, {"eccentricity_mm": "prior"}, {"loo": 12.0})


def test_a_rig_that_has_not_changed_is_called_so() -> None:
    """400 pairs of runs: false alarms of single changes stay below their 5 %, of all together at 5.

    Bonferroni on eight tests, of which L_b + e and the depths are correlated, is conservative; the
    joint test is exact: 20 of 400 expected, 4.4 their standard deviation.
    """
    rng = np.random.default_rng(0)
    single = together = 0
    for _ in range(400):
        first, other = (made(rng.multivariate_normal(TRUTH, COVARIANCE)) for _ in range(2))
        found = drift(first, other)
        single += any(change.significant for change in found.changes)
        together += found.p_value is not None and found.p_value < FAMILY_RISK
    assert single <= 20 + 2 * 4.4
    assert together == pytest.approx(20, abs=3 * 4.4)


def test_a_change_that_single_parameters_hide_is_found() -> None:
    """L_b alone moves by 4 mm: less than its own 6, ten times what L_b + e is known to."""
    moved = TRUTH + np.array([4.0, 0, 0, 0])
    found = drift(made(TRUTH), made(moved))
    by_name = {change.what: change for change in found.changes}
    assert not by_name["baseline_mm"].significant
    assert by_name["effective_baseline_mm"].significant
    assert by_name["effective_baseline_mm"].difference == pytest.approx(4.0)
    assert by_name["eccentricity_mm"].note == "identified by prior knowledge"
    assert found.p_value is not None
    assert found.p_value < 1e-6
    depth = by_name["reading of 1000 mm"]
    assert depth.significant
    # z (x + cot a) = L_b + ..., so z grows as L_b does: 4 in 120 + Z_a cot a + e.
    assert depth.difference == pytest.approx(1000 * 4 / 123, rel=0.2)


def test_runs_of_different_models_compare_what_means_the_same() -> None:
    other = replace(made(TRUTH), model="encoder")
    found = drift(made(TRUTH), other)
    assert {c.what for c in found.changes if not c.what.startswith("reading")} == {
        "effective_baseline_mm"
    }
    assert found.p_value is None
    assert not found.significant


def test_tables_say_the_same_as_text_and_html() -> None:
    runs = [made(TRUTH, "monday & tuesday"), made(TRUTH + np.array([4.0, 0, 0, 0]), "wednesday")]
    found = tables(runs, [drift(*runs)])
    page, plain = html(found), text(found)
    assert "monday &amp; tuesday" in page
    assert "monday & tuesday" in plain
    for piece in ("a significant change", "identified by prior knowledge", "+4 mm"):
        assert piece in page
        assert piece in plain
    assert "http" not in page


def test_a_run_beside_itself_has_changed_by_a_plain_nought() -> None:
    same = made(TRUTH)
    found = drift(same, same)
    assert {change.difference for change in found.changes} == {0.0}
    (_, rows) = tables([same, same], [found])[-1]
    assert {row[1].split()[0] for row in rows[1:]} == {"0"}
    assert {row[3] for row in rows[1:]} == {"0"}


def compare(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return run(parser.parse_args(arguments))


def calibration(folder: Path, baseline: float, *, serial: str | None = None) -> Path:
    """A calibration.json with what the comparison reads."""
    folder.mkdir()
    spread = {"normal": 1e-4, "width": 0.0}
    document = {
        "format": 1,
        "dataset": {"name": "rig"},
        "measurement": {
            "model": "axis-offset",
            "names": list(NAMES),
            "values": [baseline, *TRUTH[1:]],
            "covariance": COVARIANCE.tolist(),
            "reading": dict.fromkeys(("x1c", "y1c", "alpha2_rad", "gaze_residual_rad"), spread),
            "stated": {"u_x1c": 1e-4, "encoder_step_rad": 0.0, "u_alpha2_rad": 1e-4},
            "noise_factor": 1.0,
            "calibrated_depth_mm": [600.0, 1400.0],
            "factor95": 1.96,
        },
        "comparison": [{"model": "axis-offset", "loo": 30.5}],
    }  # fmt: skip
    if serial is not None:
        document["rig"] = {"serial": serial}
    (folder / "calibration.json").write_text(json.dumps(document))
    return folder


def test_command_reads_runs_and_writes_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, other = calibration(tmp_path / "a", 120.0), calibration(tmp_path / "b", 124.0)
    page = tmp_path / "drift.html"
    assert compare(str(first), str(other / "calibration.json"), "--out", str(page)) == 0
    printed = capsys.readouterr().out
    assert "effective_baseline_mm" in printed
    assert "30.5" in printed
    assert page.read_text().endswith("</html>\n")
    assert "95 % interval" in printed
    with pytest.raises(UsageError, match="two runs"):
        compare(str(first))


@pytest.mark.parametrize(
    ("serials", "told"),
    [
        ((None, None), ""),
        (("AG-1", "AG-1"), ""),
        (("AG-1", "AG-2"), "different rigs (AG-1 and AG-2)"),
        (("AG-1", None), "b: no [rig] serial"),
    ],
)
def test_runs_of_different_rigs_are_told(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    serials: tuple[str | None, str | None],
    told: str,
) -> None:
    names = zip("ab", serials, strict=True)
    runs = [str(calibration(tmp_path / name, 120.0, serial=serial)) for name, serial in names]
    assert compare(*runs) == 0
    err = capsys.readouterr().err
    assert told in err
    assert bool(told) == bool(err)


def test_datasets_that_name_no_rig_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [calibration(tmp_path / name, 120.0) for name in "ab"]
    for folder, digest in zip(runs, "34", strict=True):
        file = folder / "calibration.json"
        document = json.loads(file.read_text())
        document["dataset"] = document.get("dataset", {"name": "d"}) | {"sha256": digest * 64}
        file.write_text(json.dumps(document))
    assert compare(*map(str, runs)) == 0
    assert "nothing shows that they are of one rig" in capsys.readouterr().err


def test_a_failed_run_gives_no_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Property: also where the depths are 300 mm apart and u is so large that it hides it."""
    good, failed = calibration(tmp_path / "a", 120.0), calibration(tmp_path / "b", 150.0)
    file = failed / "calibration.json"
    gate = {"name": "residuals", "passed": False, "detail": "noise 7 times as stated"}
    file.write_text(json.dumps(json.loads(file.read_text()) | {"gates": [gate]}))
    assert compare(str(good), str(failed)) == 3
    told = capsys.readouterr()
    assert f"no verdict: gates of {failed} failed" in told.out
    assert "significant change" not in told.out
    assert "FAILED: residuals" in told.out
    assert "gate residuals FAILED: noise 7 times as stated" in told.err
    assert compare(str(good), str(failed), "--accept-failed") == 0
    assert "a significant change" in capsys.readouterr().out


def table_of(z: list[float]) -> GazeTable:
    n = len(z)
    nothing, unnamed = np.full(n, np.nan), (None,) * n
    ids = tuple(map(str, range(n)))
    x = np.linspace(-0.1, 0.2, n)
    return GazeTable(
        file="t.csv", line=tuple(range(n)), ids=ids, groups=ids, x1c=x, y1c=nothing,
        u1_px=nothing, v1_px=nothing, image_c1=unnamed, alpha2_rad=x + 1.5, u2_px=nothing,
        image_c2=unnamed, z_mm=np.array(z), u_z_mm=nothing, stereo=unnamed, references={},
        depth_row=unnamed,
    )  # fmt: skip


@pytest.mark.parametrize("count", [1, 12, 64, 65, 3000])
def test_shared_rows_are_counted(count: int) -> None:
    z = np.random.default_rng(count).uniform(500, 2000, count).tolist()
    first = sketch(table_of(z), {})
    assert first.shared_with(first) == count
    other = sketch(table_of([v + 1 for v in z]), {})
    assert first.shared_with(other) == 0
    half = [v if i < count / 2 else v + 1 for i, v in enumerate(z)]
    shared = first.shared_with(sketch(table_of(half), {}))
    of = -(-count // 2)
    if count <= 64:
        assert shared == of
    else:
        # The share of equal digests among 64: a binomial's standard deviation, as rows, five times.
        j = of / (2 * count - of)
        std = np.sqrt(j * (1 - j) / 64) * 2 * count / (1 + j) ** 2
        assert abs(shared - of) < 5 * std


def test_runs_on_the_same_rows_are_not_independent() -> None:
    z = [500.0, 700.0, 900.0, 1100.0]
    rows, others = sketch(table_of(z), {}), sketch(table_of([v + 1 for v in z]), {})
    first = replace(made(TRUTH, "first"), dataset_sha256="a", rows=rows)
    again = replace(made(TRUTH, "again"), dataset_sha256="a", rows=rows)
    (note,) = drift(first, again).notes
    assert note.startswith("the same dataset")
    x = replace(made(TRUTH, "more"), dataset_sha256="b", rows=rows)
    (note,) = drift(first, x).notes
    assert note.startswith("4 of 4 gaze rows are those of the first run")
    far = replace(made(TRUTH, "far"), dataset_sha256="b", rows=others)
    assert drift(first, far).notes == ()


def test_u_is_compared_at_the_same_depths() -> None:
    """Property: u = c z^2 comes back between the depths of the table, and nothing outside."""
    z = np.linspace(500, 2000, 21)
    one = replace(made(TRUTH), depth_u=(tuple(z), tuple(1e-6 * z**2)))
    assert one.u_at(777.0) == pytest.approx(1e-6 * 777**2, rel=1e-3)
    assert one.u_at(499.0) is None
    (_, rows) = next(t for t in tables([one, one], []) if t[0] == "u(z), mm")
    assert all(row[1] == row[2] for row in rows[1:])
