#!/usr/bin/env python3
"""Timings as ratios, side by side in one run: what the program adds, and what its methods gain.

Usage: tools/bench.py [NAME...]   (without a name all but batch, which takes a quarter of an hour)

CPU seconds; `make bench` sees to it that BLAS takes one thread. On a machine that does other
things too, compare ratios within one run only; they are good to some 15 %.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import cv2
import emcee
import numpy as np
from bench_calls import KINDS, measure_run
from bench_history import DATASETS, batches, index_and_pages
from bench_lenses import achieved
from bench_start import beside_imports
from numpy.random import SeedSequence

from calib.capture.guidance.lens import LensGuide
from calib.capture.guidance.need import Need
from calib.capture.guidance.pairs import LensSays, PairGuide, by_tape, holding_reading
from calib.capture.guidance.sweep import SweepGuide
from calib.fit.chains import ENSEMBLES
from calib.fit.density import LogPosterior
from calib.fit.importance import sample_importance
from calib.fit.posterior import laplace, posterior_of, sample_posterior
from calib.fit.priors import Priors
from calib.fit.robust import fit_model
from calib.geometry.board import Board
from calib.geometry.camera import project
from calib.geometry.parameters import vector
from calib.geometry.plane import OBSERVABLE, gaze_at
from calib.images.detection.board import find_chessboard
from calib.rows.observations import Observations
from calib.simulate.rig import draw_rig
from calib.simulate.scene import IntrinsicViews, draw_intrinsic_views, fitting_board

PROJECT = Path(__file__).resolve().parents[1]
REPEATS, RUNS = 5, 3
GOAL_DRAWS = 4000.0


@dataclass(frozen=True)
class Line:
    """One figure, beside what it is to reach."""

    what: str
    figure: str
    wanted: str


def cpu(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the median CPU time, s, of some work."""
    times = []
    for _ in range(repeats):
        started = time.process_time()
        work()
        times.append(time.process_time() - started)
    return median(times)


def rows_of(count: int) -> Observations:
    """Return rows of a rig with noise as stated."""
    rng = np.random.default_rng(1)
    theta = vector({"baseline_mm": 120.0, "delta2_rad": 0.01, "axis_z_mm": -20.0})
    z = rng.uniform(400, 2500, count)
    x, y = rng.uniform(-0.3, 0.3, (2, count))
    gaze = gaze_at(theta, np.stack([x * z, y * z, z], axis=1))
    std = np.zeros((count, 5))
    std[:, OBSERVABLE.x1c] = 2e-4
    std[:, OBSERVABLE.alpha2] = 2.8e-4
    std[:, OBSERVABLE.z] = 0.002 * z
    error = std * rng.standard_normal((count, 5))
    names = tuple(f"r{i}" for i in range(count))
    return Observations(
        ids=names,
        groups=names,
        x1c=gaze.x1c + error[:, OBSERVABLE.x1c],
        y1c=gaze.y1c,
        alpha2_rad=gaze.alpha2 + error[:, OBSERVABLE.alpha2],
        gaze_residual_rad=np.zeros(count),
        z_mm=z + error[:, OBSERVABLE.z],
        std=std,
    )


def robust() -> list[Line]:
    """Time the robust fit of a million rows."""
    rows = rows_of(1_000_000)
    seconds = cpu(lambda: fit_model(rows, Priors({}), model="axis-offset"), 1)
    return [Line("robust fit of 1,000,000 rows", f"{seconds:.1f} s", "1.5 s")]


def lmfit_seconds_per_draw(target: LogPosterior, centre: np.ndarray, steps: int) -> float:
    """Return CPU seconds an effective draw that lmfit.emcee takes on the same density."""
    import lmfit

    names = [f"p{i}" for i in range(len(centre))]
    parameters = lmfit.Parameters()
    for name, value in zip(names, centre, strict=True):
        parameters.add(name, value=float(value))

    def density(p: lmfit.Parameters) -> float:
        return float(target(np.array([[p[name].value for name in names]]))[0])

    rng = np.random.default_rng(0)
    start = centre + 1e-2 * np.abs(centre) * rng.standard_normal((32, len(centre)))
    started = time.process_time()
    peer = lmfit.Minimizer(density, parameters, nan_policy="omit")
    with contextlib.redirect_stdout(io.StringIO()):  # it advises longer chains
        peer.emcee(
            steps=steps, nwalkers=32, pos=start, progress=False, seed=1, float_behavior="posterior"
        )
    seconds = time.process_time() - started
    tau = emcee.autocorr.integrated_time(peer.sampler.get_chain(), tol=0)
    return seconds / (steps * 32 / float(tau.max()))


def posterior() -> list[Line]:
    """Compare the samplers by CPU time to as many effective draws."""
    lines = []
    for count, steps in ((6, 1500), (100, 1500)):
        rows = rows_of(count)
        fit = fit_model(rows, Priors({}), model="axis-offset")
        target = posterior_of(fit, rows, Priors({}))
        centre, covariance = laplace(fit, target)
        started = time.process_time()
        result = sample_posterior(rows, fit, Priors({}), seed=SeedSequence(0))
        chain = (time.process_time() - started) / result.ess_bulk.min()
        rng = np.random.default_rng(0)
        quick = cpu(lambda: sample_importance(target, centre, covariance, rng))  # noqa: B023 - at once
        sample = sample_importance(target, centre, covariance, rng)
        peer = lmfit_seconds_per_draw(target, centre, steps)
        n = f"N = {count}"
        lines += [
            Line(f"{n}: emcee here, CPU s to 4,000 draws", f"{chain * GOAL_DRAWS:.2f}", ""),
            Line(f"{n}: lmfit.emcee over emcee here", f"{peer / chain:.0f} x", "8 x"),
            Line(f"{n}: lmfit.emcee over importance sampling",
                 f"{peer / (quick / sample.ess):.0f} x", "1000 x"),
        ]  # fmt: skip
    return lines


def detection() -> list[Line]:
    """Compare board detection with a bare script of the same two OpenCV calls."""
    lines = []
    board = Board("chessboard", columns=9, rows=7, square_mm=25.0, target=(4, 3))
    for width, height in ((720, 576), (1280, 960), (4000, 3000)):
        image = _board_picture(width, height)

        def bare(image: np.ndarray = image) -> None:
            _, corners = cv2.findChessboardCorners(image, (9, 7))
            criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
            cv2.cornerSubPix(image, corners, (11, 11), (-1, -1), criteria)

        ours, theirs = (cpu(lambda: find_chessboard(image, board)), cpu(bare))  # noqa: B023 - at once
        wanted = "12 ms" if width > 2000 else "5 ms"
        lines.append(
            Line(f"board in {width} x {height}: bare script takes {1e3 * theirs:.0f} ms, here",
                 f"{1e3 * ours:.1f} ms", wanted)
        )  # fmt: skip
    return lines


def _board_picture(width: int, height: int) -> np.ndarray:
    """Return a clean picture of a 10 x 8 squares board, slightly turned."""
    square = 40
    flat = np.kron(np.indices((8, 10)).sum(axis=0) % 2, np.ones((square, square))) * 200 + 30
    flat = np.pad(flat, square, constant_values=230).astype(np.uint8)
    h, w = flat.shape
    corners = np.float32([[0, 0], [w, 0], [w, h], [0, h]])
    place = np.float32([[0.15, 0.12], [0.86, 0.18], [0.82, 0.88], [0.12, 0.8]])
    turn = cv2.getPerspectiveTransform(corners, place * np.float32([width, height]))
    warped = cv2.warpPerspective(flat, turn, (width, height), borderValue=230)
    return cv2.GaussianBlur(warped, (0, 0), 0.7)


def pipeline(folder: Path = PROJECT / "datasets" / "demo") -> list[Line]:
    """Compare whole runs with the library calls in them; see `bench_calls`."""
    if not folder.is_dir():
        raise SystemExit(f"bench: {folder} is missing; make datasets/demo")
    runs = [measure_run(folder) for _ in range(RUNS)]
    whole = median(run.whole for run in runs)
    waited = median(run.waited for run in runs)
    parts = [
        Line(f"run on {folder.name}, CPU s in one process", f"{whole:.1f}", ""),
        Line("the same by the clock, as a command", f"{waited:.1f}", ""),
    ]
    for kind in KINDS:
        seconds = median(run.inside[kind] for run in runs)
        parts.append(Line(f"of it {kind}", f"{seconds:.1f}", ""))
    solving = [run.calls("detectors", "solvers") for run in runs]
    every = [run.calls(*KINDS) for run in runs]
    ratios = {
        "by the clock, over detectors and solvers": (
            median(run.waited / s for run, s in zip(runs, solving, strict=True)), "1.20"),
        "CPU, over detectors and solvers": (
            median(run.whole / s for run, s in zip(runs, solving, strict=True)), "1.20"),
        "CPU, over all library calls": (
            median(run.whole / s for run, s in zip(runs, every, strict=True)), "1.15"),
    }  # fmt: skip
    return [*parts, *(Line(what, f"{r:.2f}", goal) for what, (r, goal) in ratios.items())]


def start() -> list[Line]:
    """Compare a run on the paper's six rows with the bare imports of its libraries."""
    found = beside_imports(PROJECT / "datasets" / "xu-wang-2017", repeats=REPEATS)
    return [
        Line("run on the paper's six rows, CPU", f"{found.run:.1f} s", ""),
        Line("bare imports of its libraries, CPU", f"{found.imports:.1f} s", ""),
        Line("run over bare imports", f"{found.ratio:.1f}", "2.2"),
    ]


def lenses() -> list[Line]:
    """Compare the intrinsics of one camera with its peers, by time and by error."""
    lines = []
    for bow_mm in (0.0, 0.3):
        board = f"board bowed by {bow_mm:g} mm" if bow_mm else "flat board"
        for one in achieved(bow_mm):
            if one.error_px is None:
                lines.append(Line(f"{board}, {one.name}", "absent", "apt install mrcal"))
                continue
            figure = f"{one.seconds:.2f} s, {one.error_px:.3f} px"
            lines.append(Line(f"{board}, {one.name}: CPU, error of the lens", figure, ""))
    return lines


def guidance() -> list[Line]:
    """Time the answer of a guide: the picture taken is solved, the next pose chosen."""
    rng = np.random.default_rng(1)
    rig = draw_rig(rng, model="base", image_size=(1280, 960))
    board = fitting_board(rig, near_mm=1000.0)
    need = Need()
    guide = LensGuide("c1", board, rig.c1.image_size, needed_rad=need.lens_px(1.0))
    poses = draw_intrinsic_views(rig.c1, board, rng, IntrinsicViews(count=12))
    points = board.object_points()
    for pose in poses:
        corners = project(rig.c1, points @ pose[:3, :3].T + pose[:3, 3])
        guide.add(corners + rng.normal(0, 0.1, corners.shape))
    lens = 1e3 * cpu(lambda: (guide.solve_again(), guide.ask()))
    lenses = LensSays(rig.c1, None), LensSays(rig.c2, None)
    reading = holding_reading(need, need.baseline_mm)
    pairs = PairGuide(board, lenses, by_tape(need.baseline_mm, reading), need)
    pair = 1e3 * cpu(pairs.ask)
    sweep = SweepGuide(
        board, rig.c2, np.zeros((9, 9)), range_rad=rig.yaw_range_rad,
        resolution_rad=1.6e-4, u_alpha2_rad=0.0, need=need,
    )  # fmt: skip
    axis = 1e3 * cpu(sweep.ask)
    return [
        Line("guide of a lens, 12 pictures: solved, next pose", f"{lens:.0f} ms", "150 ms"),
        Line("guide of pairs: next pose", f"{pair:.0f} ms", "150 ms"),
        Line("guide of the sweep: next pose", f"{axis:.0f} ms", "150 ms"),
    ]


def history() -> list[Line]:
    """Time the index of a fleet and its pages, as commands."""
    found = index_and_pages(PROJECT / "datasets" / "xu-wang-2017")
    wanted = {"index": "30 s", "page": "1 s"}
    return [
        Line(f"{what} (CPU {t.cpu:.1f} s)", f"{t.clock:.1f} s", wanted.get(what.split()[0], ""))
        for what, t in found.items()
    ]


def batch() -> list[Line]:
    """Compare a batch on one worker of a local Dask cluster with one on two.

    On a machine with other work the ratio by the clock is that of the shares it gives to one
    process and to two; what the program itself loses is the time in which workers wait.
    """
    one, two = batches()
    return [
        Line(f"{DATASETS} datasets on one worker, by the clock", f"{one.took.clock:.0f} s", ""),
        Line("on two workers", f"{two.took.clock:.0f} s", ""),
        Line("ratio", f"{one.took.clock / two.took.clock:.2f}", "1.80"),
        Line("CPU of the two over that of the one", f"{two.took.cpu / one.took.cpu:.2f}", ""),
        Line("one worker calibrates, of its time", f"{100 * one.busy:.1f} %", ""),
        Line("two workers calibrate, of their time", f"{100 * two.busy:.1f} %", ""),
    ]


LONG = {"batch"}
"""A quarter of an hour; only by name."""

PARTS = {
    "robust": robust,
    "posterior": posterior,
    "detection": detection,
    "guidance": guidance,
    "lenses": lenses,
    "start": start,
    "pipeline": pipeline,
    "history": history,
    "batch": batch,
}


def main(names: list[str]) -> int:
    """Print the figures asked for."""
    unknown = set(names) - set(PARTS)
    if unknown:
        print(f"bench: no part {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
        return 2
    warnings.simplefilter("ignore")  # the peers' own, which would interrupt the lines of JSON
    print(json.dumps({"cpus": os.cpu_count(), "ensembles": ENSEMBLES}))
    for name in names or [name for name in PARTS if name not in LONG]:
        for line in PARTS[name]():
            wanted = f"(to reach: {line.wanted})" if line.wanted else ""
            print(f"{line.what:56s} {line.figure:>10s}  {wanted}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
