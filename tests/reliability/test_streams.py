"""Standard streams that are closed, full or narrow: one line and the right status, no traceback.

Evidence: property, by a shell as users have it.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

SPREAD = {"normal": 0.0, "width": 0.0}
CALIBRATION = {
    "format": 1,
    "measurement": {
        "model": "base",
        "names": ["baseline_mm", "delta2_rad"],
        "values": [77.0, 0.013],
        "covariance": [[1.0, 0.0], [0.0, 1e-8]],
        "reading": dict.fromkeys(("x1c", "y1c", "alpha2_rad", "gaze_residual_rad"), SPREAD),
        "stated": {"u_x1c": 1e-4, "encoder_step_rad": 1e-3, "u_alpha2_rad": 0.0},
        "noise_factor": 1.0,
        "calibrated_depth_mm": [500, 2000],
        "factor95": 2.0,
    },
}
TABLE = "id,x1c,y1c,alpha2_deg\nä,0.05,0,87\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "c.json").write_text(json.dumps(CALIBRATION))
    (tmp_path / "t.csv").write_text(TABLE)
    return tmp_path


def shell(folder: Path, command: str, **env: str) -> subprocess.CompletedProcess[str]:
    """Run a line of sh, `calib` in it being the one under test."""
    calib = f"{shlex.quote(sys.executable)} -m calib"
    return subprocess.run(
        ["/bin/sh", "-c", command.replace("calib ", f"{calib} ", 1)],
        cwd=folder, capture_output=True, text=True, check=False, timeout=100,
        env={"PATH": "/usr/bin:/bin"} | env,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("command", "status", "word"),
    [
        ("calib measure c.json t.csv >/dev/full", 2, "standard output cannot be written"),
        ("calib measure c.json t.csv >&-", 2, "standard output cannot be written"),
        ("calib measure c.json t.csv --out o.csv >&-", 0, ""),
        ("calib measure c.json - <&-", 2, "standard input is closed"),
        ("calib measure c.json t.csv <&-", 0, ""),
        ("calib measure c.json t.csv 2>&-", 0, ""),
        ("calib measure nowhere.json t.csv 2>&-", 2, ""),
        ("calib measure nowhere.json t.csv 2>/dev/full", 2, ""),
        ("calib measure c.json t.csv <&- >&- 2>&-", 2, ""),
        ("calib history show --index nowhere >&-", 2, "nowhere"),
        ("calib --help >/dev/full", 2, "standard output cannot be written"),
        ("calib --version >/dev/full", 2, "standard output cannot be written"),
        ("calib measure --help >/dev/full", 2, "standard output cannot be written"),
        ("calib --version >&-", 2, "standard output cannot be written"),
    ],
)
def test_streams(command: str, status: int, word: str, folder: Path) -> None:
    ended = shell(folder, command)
    assert ended.returncode == status, ended
    assert word in ended.stderr
    assert len(ended.stderr.splitlines()) == (1 if word else 0), ended.stderr
    if "--out" in command:
        assert "ä" in (folder / "o.csv").read_text(encoding="utf-8")


def test_a_full_standard_error_ends_no_work(folder: Path) -> None:
    """Property: a batch goes on to its last dataset, and writes its summary."""
    for name in ("a", "b"):
        (folder / name).mkdir()
        (folder / name / "dataset.toml").write_text("format = 1\n")
    ended = shell(folder, "calib batch a b --out out --jobs 1 2>/dev/full")
    assert ended.returncode == 2
    assert "2 datasets: 2 refused" in ended.stdout
    assert (folder / "out" / "batch.csv").read_text().count("refused") == 2


def test_no_stream_takes_what_is_meant_for_a_file(folder: Path) -> None:
    """Property: with 1 and 2 closed the next file opened would get their numbers."""
    before = (folder / "c.json").read_bytes(), (folder / "t.csv").read_bytes()
    shell(folder, "calib measure c.json t.csv --out o.csv <&- >&- 2>&-")
    assert before == ((folder / "c.json").read_bytes(), (folder / "t.csv").read_bytes())
    assert (folder / "o.csv").read_text(encoding="utf-8").startswith("id,x_mm")


def test_a_reader_that_has_gone_is_no_fault(folder: Path) -> None:
    (folder / "t.csv").write_text("id,x1c,y1c,alpha2_deg\n" + "a,0.05,0,87\n" * 50_000)
    ended = shell(folder, "calib measure c.json t.csv | head -n 2")
    assert ended.stderr == ""
    assert len(ended.stdout.splitlines()) == 2


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252"])
def test_an_encoding_that_lacks_a_letter(encoding: str, folder: Path) -> None:
    (folder / "t.csv").write_text("id,x1c,y1c,alpha2_deg\nΩ,0.05,0,none\nb,0.05,0,87\n")
    ended = shell(folder, "calib measure c.json t.csv --out o.csv", PYTHONIOENCODING=encoding)
    assert ended.returncode == 3
    assert "\\u03a9" in ended.stderr
    assert "Ω" in (folder / "o.csv").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("umask", "file", "directory"), [("077", 0o600, 0o700), ("027", 0o640, 0o750)]
)
def test_umask_is_honoured(umask: str, file: int, directory: int, folder: Path) -> None:
    """Of files made anew and of folders: nobody reads what the user keeps to himself."""
    made = shell(folder, f"umask {umask}; calib measure c.json t.csv --out o.csv")
    made = (
        shell(folder, f"umask {umask}; calib simulate rig --seed 1")
        if not made.returncode
        else made
    )
    assert made.returncode == 0, made.stderr
    assert (folder / "o.csv").stat().st_mode & 0o777 == file
    assert (folder / "rig").stat().st_mode & 0o777 == directory
    assert {p.stat().st_mode & 0o777 for p in (folder / "rig").iterdir()} == {file}
