"""A run that is interrupted at any moment is taken up where it stopped, with the same result.

Evidence: property. Moments are drawn over the stages in proportion to nothing but chance: a stage,
then a time within it, so that short stages are hit as often as long ones.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import IO

import h5py
import numpy as np
import pytest
from short_chain import Started, dataset, starter

from calib.chain.calibrate import LONG_CHAINS
from calib.simulate.contents import SimulationOptions
from calib.simulate.dataset import simulate_dataset
from calib.stages.files import PARTIAL
from calib.stages.stage_file import SEAL_BYTES

Start = Callable[..., Started]
SAME = ("calibration.json", "results.h5")


@dataclass(frozen=True)
class Undisturbed:
    """A run that nothing interrupts: its files, and its stages with the time each takes, s."""

    data: Path
    out: Path
    stages: tuple[tuple[str, float], ...]


@pytest.fixture(scope="module")
def start() -> Iterator[Start]:
    with starter() as function:
        yield function


@pytest.fixture(scope="module")
def undisturbed(start: Start, tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    folder = tmp_path_factory.mktemp("whole")
    data = dataset(folder / "data")
    run = start("calibrate", data, "--out", folder / "out")
    began = [(name, time.monotonic()) for name in run.announcements()]
    assert run.status() == 0
    ends = [*(t for _, t in began[1:]), time.monotonic()]
    stages = tuple((name, e - t) for (name, t), e in zip(began, ends, strict=True))
    assert {"base/posterior", "comparison", "report"} <= {name for name, _ in stages}
    return Undisturbed(data, folder / "out", stages)


def assert_whole(out: Path) -> None:
    """Assert that every file which bears a final name is whole."""
    for path in (p for p in out.rglob("*") if p.is_file() and not p.name.endswith(PARTIAL)):
        data = path.read_bytes()
        if path.parent.name == ".stages" and path.suffix == ".h5":
            assert sha256(data[SEAL_BYTES:]).hexdigest().encode() in data[:SEAL_BYTES], path
        elif path.suffix == ".json":
            json.loads(data)
        elif path.suffix == ".toml":
            tomllib.loads(data.decode())
        elif path.suffix == ".h5":
            with h5py.File(path) as file:
                assert "observations" in file
        elif path.suffix == ".html":
            assert data.decode().rstrip().endswith("</html>"), path


def interrupt(
    start: Start, whole: Undisturbed, out: Path, how: int, chance: np.random.Generator
) -> bool:
    """Interrupt a run once, take it up again, compare; return whether it was interrupted."""
    stage = int(chance.integers(len(whole.stages)))
    delay = chance.random() * whole.stages[stage][1]
    run = start("calibrate", whole.data, "--out", out)
    lines = run.announcements()
    for _ in range(stage + 1):
        next(lines)
    time.sleep(delay)
    os.kill(run.pid, how)
    said = list(lines)
    status = run.status()
    expected = {signal.SIGKILL: -signal.SIGKILL}.get(how, 130)
    assert status in (expected, 0), said
    if how != signal.SIGKILL:
        assert not any("Traceback" in line for line in said), "\n".join(said)
        assert not list(out.rglob(f"*{PARTIAL}")), "it tidies up behind itself"
    assert_whole(out)
    finished = {p.stem.replace("--", "/") for p in (out / ".stages").glob("*.h5")}
    again = start("calibrate", whole.data, "--out", out)
    ran = [name for name in again.announcements() if name != "report"]
    assert again.status() == 0
    assert not finished & set(ran), "what was finished is reused"
    assert finished | set(ran) == {name for name, _ in whole.stages} - {"report"}
    for name in SAME:
        assert (out / name).read_bytes() == (whole.out / name).read_bytes(), (name, stage, delay)
    assert not list(out.rglob(f"*{PARTIAL}"))
    return status == expected


SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


@pytest.mark.parametrize("how", SIGNALS, ids=lambda s: s.name)
def test_interrupted_once(
    start: Start, undisturbed: Undisturbed, how: signal.Signals, tmp_path: Path
) -> None:
    interrupt(start, undisturbed, tmp_path / "out", how, np.random.default_rng(int(how)))


@pytest.mark.slow
def test_interrupted_at_thirty_moments(
    start: Start, undisturbed: Undisturbed, tmp_path: Path
) -> None:
    chance = np.random.default_rng(2017)
    hits = sum(
        interrupt(start, undisturbed, tmp_path / str(i), SIGNALS[i % 3], chance) for i in range(30)
    )
    # The rest ended before the signal came: the machine was quicker than in the undisturbed run.
    assert hits >= 20


def test_interrupted_again_and_again(
    start: Start, undisturbed: Undisturbed, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    for stage in range(0, len(undisturbed.stages), 3):
        run = start("calibrate", undisturbed.data, "--out", out)
        for _ in zip(range(1 + (stage > 0)), run.announcements(), strict=False):
            pass
        os.kill(run.pid, signal.SIGKILL)
        list(run.announcements())
        assert run.status() == -signal.SIGKILL
        assert_whole(out)
    last = start("calibrate", undisturbed.data, "--out", out)
    list(last.announcements())
    assert last.status() == 0
    for name in SAME:
        assert (out / name).read_bytes() == (undisturbed.out / name).read_bytes()


def test_second_run_on_the_same_out_is_refused(
    start: Start, undisturbed: Undisturbed, tmp_path: Path
) -> None:
    with starter() as second:
        first = start("calibrate", undisturbed.data, "--out", tmp_path)
        lines = first.announcements()
        next(name for name in lines if name == "base/posterior")
        os.kill(first.pid, signal.SIGSTOP)  # it holds the folder as long as the test wants
        try:
            other = second("calibrate", undisturbed.data, "--out", tmp_path, "--seed", "1")
            said = list(other.announcements())
            status = other.status()
        finally:
            os.kill(first.pid, signal.SIGCONT)
        list(lines)
        assert status == 2
        assert len(said) == 1
        assert "another run is writing there" in said[0]
        assert first.status() == 0
    for name in SAME:
        assert (tmp_path / name).read_bytes() == (undisturbed.out / name).read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM], ids=lambda s: s.name)
def test_interrupted_with_chains_side_by_side(how: signal.Signals, tmp_path: Path) -> None:
    """As a terminal does and as a system does: the first tells workers too, the second does not."""
    data, out = tmp_path / "data", tmp_path / "out"
    simulate_dataset(data, SimulationOptions(seed=1, rows=LONG_CHAINS))
    calib = Path(sys.executable).with_name("calib")
    with subprocess.Popen(
        [calib, "calibrate", data, "--out", out],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    ) as run:
        err: IO[str] = run.stderr  # type: ignore[assignment] # it is a pipe
        while (line := err.readline()) and line != "  axis-offset/posterior\n":
            pass
        time.sleep(1.5)
        if how == signal.SIGINT:
            os.killpg(run.pid, how)
        else:
            run.send_signal(how)
        said = err.read()
    assert run.returncode == 130, said
    assert said.splitlines()[-1].startswith("calib: interrupted")
    assert "Traceback" not in said
    with pytest.raises(ProcessLookupError):
        os.killpg(run.pid, 0)
    assert (out / ".stages" / "axis-offset--robust.h5").exists()
    assert not list(out.rglob(f"*{PARTIAL}"))
    assert_whole(out)
