"""How much of a run is spent in the library calls that it cannot do without.

Counted is CPU time of this process, all threads, and of mrcal's. Four kinds of calls:

detectors
    Decoding pictures, finding and refining boards: OpenCV.
solvers
    mrcal's processes, whole; OpenCV's calibrations and poses; scipy's least squares, cvxpy,
    emcee, importance sampling, Pareto smoothing. What they call back, such as the posterior's
    density, belongs to them.
trials
    The Monte Carlo propagation of JCGM 101 that the certificate states.
documents
    Figures by matplotlib and corner, PDF by WeasyPrint.

Everything else is overhead: reading and checking tables, starts, budgets, diagnostics of chains,
fingerprints, HDF5, JSON, HTML. Modules are imported beforehand, so that start-up counts on neither
side. All stages are computed in this process, one after the other.

Beside it stands what the user waits for: seconds of the same run as a command, start-up included,
where stages that do not need each other run side by side.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import arviz_stats.base.array
import corner
import cv2
import cvxpy
import emcee
import matplotlib.figure
import scipy.optimize
import weasyprint

import calib
import calib.fit.importance
import calib.stages.store
import calib.uncertainty.joint
from calib.chain.calibrate import Options, calibrate
from calib.dataset.load import load_dataset

KINDS = ("detectors", "solvers", "trials", "documents")

_DETECTORS = (
    "imdecode", "findChessboardCorners", "findChessboardCornersSB", "cornerSubPix", "resize",
    "GaussianBlur",
)  # fmt: skip
_CALLS: tuple[tuple[str, Any, tuple[str, ...]], ...] = (
    ("detectors", cv2, _DETECTORS),
    ("solvers", cv2, ("calibrateCamera", "stereoCalibrate", "initCameraMatrix2D", "solvePnP")),
    ("solvers", scipy.optimize, ("least_squares",)),
    ("solvers", cvxpy.Problem, ("solve",)),
    ("solvers", emcee.EnsembleSampler, ("run_mcmc",)),
    ("solvers", calib.fit.importance, ("sample_importance",)),
    ("solvers", arviz_stats.base.array.array_stats, ("psislw",)),
    ("trials", calib.uncertainty.joint, ("propagate_together",)),
    ("documents", matplotlib.figure.Figure, ("savefig", "add_subplot", "subplots")),
    ("documents", corner, ("corner",)),
    ("documents", weasyprint.HTML, ("write_pdf",)),
)


@dataclass(frozen=True)
class RunTimes:
    """Of a whole run: CPU seconds, all and inside calls of each kind; seconds as a command."""

    whole: float
    inside: Counter[str]
    waited: float

    def calls(self, *kinds: str) -> float:
        """Return the CPU seconds inside calls of these kinds."""
        return sum(self.inside[kind] for kind in kinds)


class _Meter:
    """Adds up the time in calls, in whatever thread; of nested ones the outermost counts."""

    def __init__(self) -> None:
        self.inside: Counter[str] = Counter()
        self._lock, self._own = threading.Lock(), threading.local()

    def timed(self, kind: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            if getattr(self._own, "busy", False):
                return function(*arguments, **named)
            self._own.busy, started = True, time.thread_time()
            try:
                return function(*arguments, **named)
            finally:
                self._own.busy = False
                with self._lock:
                    self.inside[kind] += time.thread_time() - started

        return call


def _modules() -> Iterator[Any]:
    """Import and yield all modules of calib but those that run as scripts."""
    for found in pkgutil.walk_packages(calib.__path__, "calib."):
        if not found.name.endswith(("__main__", "mrcal_worker")):
            yield importlib.import_module(found.name)


@contextmanager
def _metered(meter: _Meter) -> Iterator[None]:
    """Measure the calls, by whatever name modules have imported them."""
    modules = list(_modules())
    with ExitStack() as stack:
        stack.enter_context(patch.object(calib.stages.store, "processors", lambda: 1))
        for kind, owner, names in _CALLS:
            for name in names:
                function = getattr(owner, name)
                call = meter.timed(kind, function)
                stack.enter_context(patch.object(owner, name, call))
                for module in modules:
                    if vars(module).get(name) is function:
                        stack.enter_context(patch.object(module, name, call))
        yield


def _children() -> float:
    used = os.times()
    return used.children_user + used.children_system


def measure_run(folder: Path) -> RunTimes:
    """Run the whole chain on the dataset in `folder` twice, all stages anew."""
    meter = _Meter()
    with tempfile.TemporaryDirectory() as out, _metered(meter):
        started, before = time.process_time(), _children()
        calibrate(
            load_dataset(folder),
            Path(out),
            Options(),
            announce=lambda name: print(f"  {name}", file=sys.stderr),
            progress=lambda *_: None,
            command="bench",
        )
        others = _children() - before
        whole = time.process_time() - started + others
    meter.inside["solvers"] += others
    return RunTimes(whole, meter.inside, _seconds(folder))


def _seconds(folder: Path) -> float:
    """Return how long the command takes."""
    with tempfile.TemporaryDirectory() as out:
        arguments = [str(Path(sys.executable).with_name("calib")), "calibrate", str(folder)]
        started = time.perf_counter()
        done = subprocess.run(
            [*arguments, "--out", out], capture_output=True, check=False, text=True
        )
        seconds = time.perf_counter() - started
    if done.returncode not in (0, 3):
        raise SystemExit(f"bench: {folder}: {done.stderr}")
    return seconds
