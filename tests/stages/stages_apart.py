"""Stages for these tests that a worker can import: good ones, and ones that go wrong."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.random import SeedSequence

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError, InputError, Problem


@dataclass(frozen=True)
class Numbers:
    """Some numbers, and where they were made."""

    values: FloatArray
    process: int = 0


def draw(
    source: Numbers, *, seed: SeedSequence, progress: Callable[[int, int], None] | None = None
) -> Numbers:
    """Return the source with noise."""
    sys.stdout.write("a library that speaks to standard output\n")
    if progress is not None:
        progress(1, 2)
        progress(2, 2)
    noise = np.random.default_rng(seed).standard_normal(source.values.shape)
    return Numbers(source.values + noise)


def place(source: Numbers) -> Numbers:
    """Tell the process, after long enough for the others to have begun."""
    time.sleep(0.3)
    return Numbers(source.values, os.getpid())


def refuse(source: Numbers) -> Numbers:
    """Fail as a stage may."""
    raise EstimationError(f"{len(source.values)} numbers are too few")


def die(source: Numbers) -> Numbers:
    """End as under a system without memory."""
    time.sleep(0.5)
    os.kill(os.getpid(), signal.SIGKILL)
    return source


def be_ended(source: Numbers) -> Numbers:
    """Be asked to end from outside, as by an administrator."""
    time.sleep(0.5)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(60)
    return source


def break_down(source: Numbers) -> Numbers:
    """Fail by a defect."""
    return Numbers(source.values / {}["nothing"])


def mislead(source: Numbers) -> Numbers:
    """Raise what a file that cannot be used raises."""
    first = Problem("a.png", f"is no picture of {len(source.values)}", "send another")
    raise InputError([first, Problem("b.png", "as bad", "as well")])


def leave(source: Numbers) -> Numbers:
    """End the process, as a library might."""
    os._exit(len(source.values) + 2)


def call_out(source: Numbers, *, note: str, progress: Callable[[int, int], None]) -> Numbers:
    """Wait for a process of its own, as a solve by mrcal does; leave its id in a file."""
    with subprocess.Popen(["/bin/sleep", "60"]) as process:
        try:
            Path(note).write_text(str(process.pid))
            progress(1, 2)
            process.wait()
        finally:
            process.kill()
    return source


def linger(source: Numbers, *, note: str, progress: Callable[[int, int], None]) -> Numbers:
    """Leave the process id in a file and go on for a minute."""
    Path(note).write_text(str(os.getpid()))
    for done in range(600):
        progress(done, 600)
        time.sleep(0.1)
    return source
