"""One dataset of a batch: calibrated by a process of its own, whose end says how it went.

A process of its own, so that nothing a dataset does to it (a crash of a native library, a system
short of memory) reaches another. `calib calibrate` reuses what is finished, so a batch that was
stopped goes on where it was. Where the process of a batch that was killed is still at work (a
cluster's workers do not know that nobody waits for them any more) its end is waited for.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Literal

from calib.core.parent import ending_with_this
from calib.stages.files import IN_USE, is_in_use
from calib.stages.parallel import PROCESSORS

Ending = Literal["passed", "gates failed", "refused", "crashed"]

_ENDINGS: dict[int, Ending] = {0: "passed", 3: "gates failed", 2: "refused"}

SAID = 10
"""Lines of what a refused run said that are kept."""

ASKED_AGAIN_S = 0.5
"""Between two looks whether another run has left a folder."""

_STAGE = "  "
"""Begins the lines that name stages at work."""


@dataclass(frozen=True)
class DatasetTask:
    """A dataset to calibrate.

    Parameters
    ----------
    dataset, out
        Its folder and that of its run, absolute.
    seed
        Of the run.
    force
        Whether files of other tools in `out` may be replaced.
    """

    dataset: str
    out: str
    seed: int = 0
    force: bool = False


@dataclass(frozen=True)
class Outcome:
    """How the calibration of a dataset ended.

    Parameters
    ----------
    said
        Of a run that gave no result: what it said, at most `SAID` lines.
    """

    task: DatasetTask
    ending: Ending
    said: tuple[str, ...] = ()


class Children:
    """The processes at work for a batch on this machine, so that all can be ended at once."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._at_work: set[subprocess.Popen[bytes]] = set()
        self._ended = False

    @contextmanager
    def counted(self, process: subprocess.Popen[bytes]) -> Iterator[None]:
        """Count a process while it works; one that starts after the end is ended too."""
        with self._lock:
            self._at_work.add(process)
            if self._ended:
                process.terminate()
        try:
            yield
        finally:
            with self._lock:
                self._at_work.discard(process)

    @property
    def ended(self) -> bool:
        """Whether they were asked to end: nothing new is to begin."""
        return self._ended

    def end(self) -> None:
        """Ask all of them to end."""
        with self._lock:
            self._ended = True
            for process in self._at_work:
                process.terminate()


def calibrate_one(task: DatasetTask, children: Children | None = None) -> Outcome:
    """Calibrate one dataset on one processor; never raises for what the dataset holds."""
    counted = children or Children()
    while True:
        outcome = _calibrate(task, counted)
        if counted.ended or not any(IN_USE in line for line in outcome.said):
            return outcome
        while is_in_use(Path(task.out)) and not counted.ended:
            time.sleep(ASKED_AGAIN_S)


def _calibrate(task: DatasetTask, children: Children) -> Outcome:
    here = str(Path(__file__).parents[2])
    search = os.pathsep.join(filter(None, (here, os.environ.get("PYTHONPATH"))))
    # `--`: names may begin with a dash. -P: not the working directory, where anything may lie.
    command = [sys.executable, "-P", "-m", "calib", "calibrate", "--out", task.out]
    command += ["--seed", str(task.seed), *(["--force"] if task.force else []), "--", task.dataset]
    with (
        subprocess.Popen(  # noqa: S603 - no shell; this very interpreter
            command,
            env={**os.environ, **ending_with_this(), PROCESSORS: "1", "PYTHONPATH": search},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        ) as process,
        children.counted(process),
    ):
        _, err = process.communicate()
    ending = _ENDINGS.get(process.returncode, "crashed")
    lines = err.decode(errors="replace").splitlines()
    said = [line.removeprefix("calib: ") for line in lines if line.strip()]
    said = [line for line in said if not line.startswith(_STAGE) or ending == "crashed"]
    if ending == "crashed":
        said = [*said[-SAID + 1 :], f"ended with status {process.returncode}"]
    if ending in ("passed", "gates failed"):
        said = []
    return Outcome(task, ending, tuple(said[:SAID]))
