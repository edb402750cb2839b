"""Long tables and many pictures. Evidence: simulated truth, what the kernel says of the process."""

from __future__ import annotations

import json
import os
import pty
import sys
import termios
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from calib.simulate.contents import IntrinsicViews, SimulationOptions, SweepPlan
from calib.simulate.dataset import simulate_dataset

CALIB = Path(sys.executable).with_name("calib")


@dataclass(frozen=True)
class Usage:
    """How a run ended, the most memory it held, MB, and what a terminal showed meanwhile."""

    status: int
    peak_mb: float
    shown: str


def calibrate(folder: Path, out: Path) -> Usage:
    """Run the chain in a process of its own, on a terminal."""
    keyboard, screen = pty.openpty()
    termios.tcsetwinsize(screen, (24, 100))
    arguments = [str(CALIB), "calibrate", str(folder), "--out", str(out)]
    actions = [(os.POSIX_SPAWN_DUP2, screen, 2), (os.POSIX_SPAWN_CLOSE, keyboard)]
    child = os.posix_spawn(arguments[0], arguments, os.environ, file_actions=actions)
    os.close(screen)
    pieces: list[bytes] = []

    def read() -> None:
        while True:
            try:
                piece = os.read(keyboard, 65536)
            except OSError:  # the terminal's other end is closed
                return
            if not piece:
                return
            pieces.append(piece)

    reader = threading.Thread(target=read)
    reader.start()
    _, status, used = os.wait4(child, 0)
    reader.join()
    os.close(keyboard)
    shown = b"".join(pieces).decode(errors="replace")
    return Usage(os.waitstatus_to_exitcode(status), used.ru_maxrss / 1024, shown)


def assert_truth(folder: Path, out: Path) -> None:
    """Every parameter of the model simulated within 4 of its standard deviations."""
    truth = json.loads((folder / "truth.json").read_text())["parameters"]
    document = json.loads((out / "calibration.json").read_text())
    fit = document["fits"]["axis-offset/posterior"]
    assert fit["converged"]
    found = {name: p for name, p in fit["parameters"].items() if name in truth}
    pulls = {name: (p["value"] - truth[name]) / p["std"] for name, p in found.items()}
    assert len(pulls) == 4
    assert np.abs(list(pulls.values())).max() < 4, pulls


@pytest.mark.slow
def test_long_tables(tmp_path: Path) -> None:
    """20,000 rows to calibrate with and as many to validate: memory in bounds, all is written.

    The interpreter with its libraries takes 250 MB of it, each row 7 kB, most of it while
    calibration.json and the chains' diagnostics are made.
    """
    options = SimulationOptions(seed=3, rows=20_000, validation_rows=20_000)
    simulate_dataset(tmp_path / "rig", options)
    used = calibrate(tmp_path / "rig", tmp_path / "out")
    assert used.status == 0, used.shown[-2000:]
    assert used.peak_mb < 600
    assert_truth(tmp_path / "rig", tmp_path / "out")
    for stage in ("encoder/posterior", "comparison", "validation"):
        assert f"{stage}: " in used.shown
    # Nobody reads 20,000 lines: report and certificate list some, calibration.json has all.
    assert (tmp_path / "out" / "report.html").stat().st_size < 5e6
    assert (tmp_path / "out" / "certificate.pdf").stat().st_size < 1e6
    document = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert len(document["validation"]) == 20_000


@pytest.mark.slow
def test_many_pictures(tmp_path: Path) -> None:
    """350 pictures: one after the other through memory, with progress."""
    options = SimulationOptions(
        seed=7,
        rows=14,
        validation_rows=6,
        images=True,
        image_size=(640, 480),
        views=IntrinsicViews(count=135),
        sweep=SweepPlan(placements=2, images=8),
        fixed={"baseline_mm": 150.0},
    )
    simulate_dataset(tmp_path / "rig", options)
    pictures = len(list((tmp_path / "rig").rglob("*.png")))
    assert pictures >= 350
    used = calibrate(tmp_path / "rig", tmp_path / "out")
    assert used.status == 0, used.shown[-2000:]
    assert used.peak_mb < 500
    assert_truth(tmp_path / "rig", tmp_path / "out")
    assert "corners c1: " in used.shown
