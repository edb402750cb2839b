"""Results for the tests of the report.

The gaze part comes from the real chain on the paper's data, with chains cut short; the image part
is put together by hand from small arrays, the maps by the functions that make them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

import calib.fit.chains
from calib.chain.calibrate import Options, calibrate
from calib.core.gate import Gate
from calib.dataset.load import load_dataset
from calib.geometry.board import Corners, LensFit
from calib.geometry.camera import Camera
from calib.images.contact_sheet import ContactSheet
from calib.images.intrinsics.calibrate import Intrinsics
from calib.images.intrinsics.maps import (
    compare,
    map_uncertainty,
    measure_coverage,
    nodes,
    rays_of,
)
from calib.images.intrinsics.validate import CrossValidation
from calib.images.result import ImageResult
from calib.images.stereo.reference import StereoReference
from calib.images.stereo.solve import StereoSolve
from calib.images.stereo.triangulate import PairPositions, PairTargets
from calib.images.sweep.yaw_axis import SweepResult
from calib.report.context import ReportContext, report_context
from calib.results.calibration import Calibration
from calib.stages.provenance import Provenance

DATASET = Path(__file__).parents[2] / "datasets" / "xu-wang-2017"

MADE = Provenance(
    finished="2026-01-02T03:04:05+00:00",
    version="0.1.0",
    commit="0123456789ab",
    python="3.11.2",
    system="Linux x86_64",
    packages={"numpy": "2.2.0", "scipy": "1.15.0"},
    command="calib calibrate datasets/xu-wang-2017",
    durations_s={"base/posterior": 1.25},
)

SHORT = {"TAU_MULTIPLE": 3.0, "ESS_GOAL": 50.0, "R_HAT_LIMIT": 2.0, "WALKER_R_HAT_LIMIT": 9.0}


@cache
def paper() -> tuple[Calibration, ReportContext]:
    """Return the calibration of the paper's data, with what the report prints beside it."""
    dataset = load_dataset(DATASET)
    with pytest.MonkeyPatch.context() as patch, TemporaryDirectory() as out:
        for name, value in SHORT.items():
            patch.setattr(calib.fit.chains, name, value)
        run = calibrate(
            dataset,
            Path(out),
            Options(),
            announce=lambda _: None,
            progress=lambda *_: None,
            command=MADE.command,
        )
    return run.calibration, report_context(dataset, MADE)


SIZE = (640, 480)
VIEWS = 7
COLUMNS, ROWS = 5, 4
NAMES = tuple(f"c/{i:02d}.png" for i in range(VIEWS))


def _corners(rng: np.random.Generator) -> Corners:
    u, v = np.meshgrid(np.linspace(0, 200, COLUMNS), np.linspace(0, 150, ROWS))
    board = np.stack([u.ravel(), v.ravel()], axis=-1)
    shift = rng.uniform([10, 10], [400, 300], (VIEWS, 1, 2))
    pixels = board + shift
    pixels[1, 3] = np.nan
    pixels[6] = np.nan
    found = ("cascade:classic",) * (VIEWS - 1) + ("none",)
    return Corners(NAMES, pixels, found, SIZE)


CAMERA = Camera(np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]), np.zeros(5), SIZE)


def _fit(backend: str, lens: str, corners: Corners, rng: np.random.Generator) -> LensFit:
    focal = 600 + rng.normal(0, 0.3)
    matrix = np.array([[focal, 0, 320.0], [0, focal, 240.0], [0, 0, 1.0]])
    residuals = np.where(
        np.isfinite(corners.pixels), rng.normal(0, 0.1, corners.pixels.shape), np.nan
    )
    return LensFit(
        backend=backend,
        lens_model=lens,
        camera=Camera(matrix, np.array([-0.2, 0.05, 0.0, 0.0, 0.0]), SIZE),
        covariance=np.diag([0.09, 0.09, 0.04, 0.04, 1e-6, 1e-6, 1e-8, 1e-8, 1e-6]),
        rms_px=float(np.sqrt(np.nanmean(residuals**2))),
        residuals=residuals,
        poses=np.zeros((VIEWS, 6)),
        rejected=2,
        board_warp_mm=(0.12, -0.03) if backend == "mrcal" else None,
    )


def intrinsics(name: str, corners: Corners, rng: np.random.Generator) -> Intrinsics:
    """Return intrinsics as the stage would."""
    selected = _fit("mrcal", "LENSMODEL_OPENCV5", corners, rng)
    other = _fit("opencv", "plumb-bob", corners, rng)
    at = nodes(corners.pixels, SIZE)
    rms = rng.uniform(0.08, 0.12, (2, VIEWS))
    rms[:, -1] = np.nan
    return Intrinsics(
        name=name,
        selected=selected,
        covariance=1.5 * selected.covariance,
        dispersion=1.5,
        alternatives=(other,),
        selection="plumb-bob predicts left-out views as well as rational",
        images=NAMES,
        rejected_views=(),
        detectors={"cascade:classic": VIEWS - 1, "none": 1},
        coverage=measure_coverage(corners.pixels, SIZE),
        uncertainty=map_uncertainty(selected, at),
        differences=(compare(selected, rays_of(other, at), at),),
        validation=CrossValidation(
            images=NAMES,
            lenses=("plumb-bob", "rational"),
            view_rms_px=rms,
            rms_px=np.nanmean(rms, axis=1),
            fitted_rms_px=np.array([0.1, 0.09]),
            std_jackknife=np.array([0.4, 0.4, 0.2, 0.2]),
            ratio=np.array([1.08, 1.1]),
            chosen="plumb-bob",
            reason="plumb-bob 0.101 px, rational 0.100 px",
        ),
        model_files={},
        mrcal_version="2.4",
        gates=(Gate(f"{name}-coverage", passed=True, detail="94 % of the cells"),),
        warnings=(),
        purposes={},
    )


def stereo(rng: np.random.Generator) -> StereoReference:
    """Return a stereo reference as the stage would."""
    stems = tuple(f"p{i}" for i in range(VIEWS))
    pose = np.array([0.001, -0.08, 0.002, 99.8, 1.1, 0.5])
    covariance = np.diag([1e-3, 1e-3, 3e-4, 0.05, 0.04, 0.2]) ** 2
    solves = tuple(
        StereoSolve(
            backend=backend,
            intrinsics=kind,
            pose_12=pose + 1e-4 * k,
            covariance=covariance,
            noise_covariance=covariance / 2,
            by_intrinsics=np.zeros((6, 18)),
            rms_px=0.11 + 0.01 * k,
            sigma_px=0.12,
            dispersion=1.0,
            residuals=rng.normal(0, 0.1, (2, VIEWS, COLUMNS * ROWS, 2)),
            poses=np.zeros((VIEWS, 6)),
            rejected=k,
            board_warp_mm=None,
            cameras=(CAMERA, CAMERA),
        )
        for k, (backend, kind) in enumerate(
            [("joint", "free"), ("mrcal", "free"), ("opencv", "held"), ("joint", "held")]
        )
    )
    place = np.stack(
        [np.linspace(-200, 200, VIEWS), np.zeros(VIEWS), np.linspace(700, 1500, VIEWS)], 1
    )
    spread = np.broadcast_to(np.diag([0.1, 0.1, 1.0]), (VIEWS, 3, 3)).copy()
    by_shared = np.zeros((VIEWS, 3, 2))
    miss = rng.uniform(0, 0.1, VIEWS)
    return StereoReference(
        source="joint",
        stems=stems,
        turned=("p3",),
        transform_12=np.eye(4),
        pose_12=pose,
        covariance=covariance,
        baseline_mm=99.81,
        baseline_std_mm=0.05,
        rms_px=0.11,
        solves=solves,
        targets=PairTargets(
            stems=stems,
            triangulated=PairPositions(place, spread, by_shared, miss),
            shared_names=("a", "b"),
            shared_covariance=np.eye(2),
            depth_std_mm=np.linspace(1.0, 2.0, VIEWS),
            by_board=PairPositions(place + rng.normal(0, 1, place.shape), spread, by_shared, miss),
            board_sigmas=rng.normal(0, 1, VIEWS),
        ),
        gates=(Gate("stereo-fit", passed=True, detail="rms 0.11 px"),),
        lenses=(),
    )


def sweep(rng: np.random.Generator) -> SweepResult:
    """Return a yaw sweep as the stage would."""
    names = ("eccentricity_mm", "gaze_roll_rad", "encoder_scale")
    return SweepResult(
        axis_direction_c2=np.array([0.001, 0.99999, -0.002]),
        axis_foot_c2_mm=np.array([-14.9, 0.1, -20.3]),
        axis_covariance=np.diag([1e-8, 1e-8, 0.04, 0.09]),
        eccentricity_mm=14.9,
        eccentricity_std_mm=0.2,
        gaze_roll_rad=0.001,
        gaze_roll_std_rad=0.0002,
        encoder_scale=0.001,
        encoder_scale_std=0.002,
        names=names,
        mean=np.array([14.9, 0.001, 0.001]),
        covariance=np.diag([0.2, 0.0002, 0.002]) ** 2,
        rms_px=0.1,
        sigma_px=0.11,
        dispersion=1.2,
        residuals=rng.normal(0, 0.1, (9, COLUMNS * ROWS, 2)),
        images=tuple(f"s/{i}.png" for i in range(9)),
        readings_rad=np.deg2rad(np.linspace(60, 120, 9)),
        placements=("a", "b"),
        poses=np.zeros((2, 6)),
        reading_errors_rad=rng.normal(0, 1e-4, 9),
        rejected=3,
        gates=(Gate("sweep-fit", passed=True, detail="rms 0.1 px"),),
    )


@cache
def images() -> ImageResult:
    """Return all that images can give."""
    rng = np.random.default_rng(5)
    corners = {name: _corners(rng) for name in ("c1", "c2")}
    pictures = rng.integers(0, 255, (VIEWS, 48, 64)).astype(np.uint8)
    return ImageResult(
        corners=corners,
        sheets={
            name: ContactSheet(name, NAMES, corners[name].detector, pictures) for name in corners
        },
        intrinsics={name: intrinsics(name, corners[name], rng) for name in corners},
        stereo=stereo(rng),
        sweep=sweep(rng),
    )


@cache
def everything() -> tuple[Calibration, ReportContext]:
    """Return a calibration with all sections."""
    calibration, context = paper()
    published = {"c1.fx": (900.0, 1.0), "c1_in_c2.translation_x_mm": (-120.0, 0.5)}
    reason = "adjustment of all pictures: its steps do not settle"
    calibration = replace(calibration, images=images(), not_adjusted=reason)
    return calibration, replace(context, published=published)
