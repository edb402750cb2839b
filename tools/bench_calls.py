"""How much of a run is spent in the library calls that it cannot do without.

Counted is CPU time of this process, all threads, and of mrcal's. Four kinds of calls:

detectors
    Decoding pictures, finding and refining boards: OpenCV.
solvers
    mrcal's processes, whole; OpenCV's calibrations and poses; scipy's least squares, cvxpy, emcee
    with its autocorrelation times, importance sampling, Pareto smoothing. What they call back, such
    as the posterior's density, belongs to them.
trials
    The Monte Carlo propagation of JCGM 101 that the certificate states.
documents
    Figures by matplotlib and corner, PDF by WeasyPrint.

Everything else is overhead: reading and checking tables, starts, budgets, diagnostics of chains,
fingerprints, HDF5, JSON, HTML. Modules are imported beforehand, so that start-up counts on neither
side.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
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
import calib.uncertainty.montecarlo
from calib.dataset.load import load_dataset
from calib.pipeline import Options, calibrate

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
    ("solvers", emcee.autocorr, ("integrated_time",)),
    ("solvers", calib.fit.importance, ("sample_importance",)),
    ("solvers", arviz_stats.base.array.array_stats, ("psislw",)),
    ("trials", calib.uncertainty.montecarlo, ("propagate",)),
    ("documents", matplotlib.figure.Figure, ("savefig", "add_subplot", "subplots")),
    ("documents", corner, ("corner",)),
    ("documents", weasyprint.HTML, ("write_pdf",)),
)


@dataclass(frozen=True)
class RunTimes:
    """CPU seconds of a whole run, and inside calls of each kind."""

    whole: float
    inside: Counter[str]

    def over(self, *kinds: str) -> float:
        """Return the whole over the time inside calls of these kinds."""
        return self.whole / sum(self.inside[kind] for kind in kinds)


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
    """Run the whole chain on the dataset in `folder`, all stages anew."""
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
    return RunTimes(whole, meter.inside)
