"""Stage: the yaw sweep, C2 turned through known angles before a board at rest.

Its images give the yaw axis in C2's frame and the encoder's errors, by bundle adjustment. From the
axis follow three parameters of the turning plane (`calib.geometry.plane`). The gaze plane is plane
x = 0 of C2's frame; it has the normal n = (1, 0, 0) and holds C2's centre, the origin. It reads
n . P = n . p + e with p the point in which the axis crosses the plane Y = 0 of C1, hence

    e = -n . p = -(f_x + h d_x),      sin(roll) = n . d = d_x,

d being the direction of the axis, f its foot and h the way along the axis from the foot to p. C2's
centre stands ahead of p by -(f_z + h d_z) along its optical axis, the standoff. Only a rolled C2
makes e depend on h, and only a pitched one the standoff; 1T2 tells h: 10 mm at 1 degree are
0.17 mm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.gate import Gate
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera
from calib.geometry.parameters import STANDOFF
from calib.geometry.poses import rotation
from calib.images.bundle import finite
from calib.images.checks import fit_gate, gate
from calib.images.mrcal.solves import MIN_CORNERS
from calib.images.sweep.model import AXIS, ENCODER, Axis, SweepProblem, axis_of, residuals_of
from calib.images.sweep.solve import SweepReadings, solve_sweep

MIN_SPAN_RAD = float(np.deg2rad(10.0))
"""Below, a board changes its size in the image by e span / z: for 1 mm at 1 m and 2 degrees by
3e-5, or 0.005 px at the edge of a large board, which is the bias of good corner detectors."""

ECCENTRICITY_STD_LIMIT_MM = 1.0
"""The gaze rows alone leave e to its prior of some 10 mm, and L_b with it."""

SCALE_LIMIT = 0.05
"""Encoders and gears are right to 1 %; more is a wrong unit, step count or gear ratio."""

READING_LIMIT = 10.0
"""Stated standard uncertainties of a reading by which it may err: backlash makes up to some five; a
slip of the pen is degrees."""

SMALL_READING_ERROR_RAD = float(np.deg2rad(0.05))
"""The paper's step: no reading is a slip for less, however fine the encoder is said to be."""

HEIGHT_STD_MM = 20.0
"""C1 and C2 are mounted level within this, where no 1T2 tells."""

NAMES: tuple[str, ...] = (
    "eccentricity_mm",
    "gaze_roll_rad",
    *(parameter.name for parameter, _ in ENCODER),
    STANDOFF,
)
"""Parameters of the turning plane that a sweep can measure."""

_REPORTED = ("eccentricity_mm", "gaze_roll_rad", "encoder_scale")


@dataclass(frozen=True)
class SweepResult:
    """The yaw axis of C2 and what follows from it.

    Parameters
    ----------
    axis_direction_c2
        Unit vector, C2's frame, near +Y, shape (3,).
    axis_foot_c2_mm
        Point of the axis nearest to C2's centre, C2's frame, shape (3,).
    axis_covariance
        Of d_x, d_z (1) and f_x, f_z (mm), shape (4, 4).
    eccentricity_mm, eccentricity_std_mm
        Distance e of the gaze plane from the axis, and its standard uncertainty.
    gaze_roll_rad, gaze_roll_std_rad
        Roll of C2 against its yaw axis.
    encoder_scale, encoder_scale_std
        Scale error of the encoder about 90 degrees.
    names, mean, covariance
        What the sweep measures, as a normal density without any prior of these parameters of the
        model: k names, (k,), (k, k). Encoder terms that it does not show are left out; their
        priors have widened the rest.
    rms_px
        Root mean square of the residual per coordinate over inliers.
    sigma_px
        The same per degree of freedom.
    dispersion
        Variance of the axis as the images show it over that which independent corner noise
        explains, see `calib.images.bundle.dispersion`; all covariances here contain it.
    residuals
        Observed minus projected, px, shape (n, corners, 2); NaN where missing or rejected.
    images, readings_rad
        The n images used, and the encoder's readings in them, shape (n,).
    placements
        Names of the placements, m.
    poses
        C2 at 90 degrees from board, for each placement, rad and mm, shape (m, 6).
    reading_errors_rad
        True turn less that of the calibrated encoder, each image, shape (n,).
    rejected
        Corners discarded as outliers.
    gates
        What must hold before the result may be used.
    """

    axis_direction_c2: FloatArray
    axis_foot_c2_mm: FloatArray
    axis_covariance: FloatArray
    eccentricity_mm: float
    eccentricity_std_mm: float
    gaze_roll_rad: float
    gaze_roll_std_rad: float
    encoder_scale: float
    encoder_scale_std: float
    names: tuple[str, ...]
    mean: FloatArray
    covariance: FloatArray
    rms_px: float
    sigma_px: float
    dispersion: float
    residuals: FloatArray
    images: tuple[str, ...]
    readings_rad: FloatArray
    placements: tuple[str, ...]
    poses: FloatArray
    reading_errors_rad: FloatArray
    rejected: int
    gates: tuple[Gate, ...]


def yaw_sweep(
    corners: Corners,
    readings: SweepReadings,
    board: Board,
    *,
    camera: Camera,
    covariance: FloatArray,
    pose_12: FloatArray | None = None,
    warp_mm: tuple[float, float] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
) -> SweepResult:
    """Solve the yaw axis in C2's frame and the encoder's errors.

    Parameters
    ----------
    corners
        Of C2, one view a reading.
    camera, covariance
        C2's intrinsics with their covariance, shape (4 + k, 4 + k); they may move within it.
    pose_12
        Pose of C2 in C1, shape (6,), if known: where the axis crosses C1's plane Y = 0.
    warp_mm
        Board deformation along x and y, mm, where it is known.
    priors
        (mean, standard deviation) of encoder terms, by name, in place of the defaults.

    Raises
    ------
    EstimationError
        If there are too few images or readings, the board is not the one stated, or the encoder
        counts the other way round.
    """
    solution = solve_sweep(
        corners,
        readings,
        board,
        camera=camera,
        covariance=covariance,
        warp_mm=warp_mm,
        priors=priors or {},
    )
    x, problem = solution.minimum.x, solution.problem
    axis = axis_of(x)
    unknowns = AXIS + len(ENCODER)
    spread = solution.dispersion * solution.spread[:unknowns, :unknowns]
    height = _height(axis, pose_12)
    mean, covariance_all = _parameters(x, spread, *height)
    std = np.sqrt(np.diag(covariance_all))
    e, roll, scale = (NAMES.index(name) for name in _REPORTED)
    shown = [True, True, *(not np.isfinite(prior) for _, prior in problem.encoder_prior), True]
    kept = np.flatnonzero(shown)
    residuals = residuals_of(problem, x)
    errors = np.zeros(len(residuals))
    errors[: len(problem.at_turns)] = problem.turn_std_rad * x[problem.at_turns]
    result = SweepResult(
        axis_direction_c2=axis.direction,
        axis_foot_c2_mm=axis.foot,
        axis_covariance=spread[:AXIS, :AXIS],
        eccentricity_mm=float(mean[e]),
        eccentricity_std_mm=float(std[e]),
        gaze_roll_rad=float(mean[roll]),
        gaze_roll_std_rad=float(std[roll]),
        encoder_scale=float(mean[scale]),
        encoder_scale_std=float(std[scale]),
        names=tuple(NAMES[i] for i in kept),
        mean=mean[kept],
        covariance=covariance_all[np.ix_(kept, kept)],
        rms_px=float(np.sqrt(np.nanmean(residuals**2))),
        sigma_px=problem.sigma_px,
        dispersion=solution.dispersion,
        residuals=residuals,
        images=solution.images,
        readings_rad=problem.readings_rad,
        placements=solution.placements,
        poses=np.array([x[problem.at_pose(k)] for k in range(problem.placements)]),
        reading_errors_rad=errors,
        rejected=solution.rejected,
        gates=(),
    )
    return replace(result, gates=_gates(result, _span(problem), readings.std_rad, height[1]))


def _parameters(
    x: FloatArray, spread: FloatArray, height_mm: float, height_std_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Return the model's parameters `NAMES` with their covariance.

    Parameters
    ----------
    x, spread
        Unknowns, and the covariance of those of axis and encoder.
    height_mm, height_std_mm
        From the axis' foot along the axis to C1's plane Y = 0.
    """
    dx, dz, fx, fz = (float(v) for v in x[:AXIS])
    mean = np.concatenate(
        [
            [-(fx + height_mm * dx), np.arcsin(dx)],
            x[AXIS : len(spread)],
            [-(fz + height_mm * dz)],
        ]
    )
    jacobian = np.zeros((len(mean), len(spread)))
    jacobian[0, [0, 2]] = -height_mm, -1.0
    jacobian[1, 0] = 1 / np.sqrt(1 - dx**2)
    jacobian[2:-1, AXIS:] = np.eye(len(ENCODER))
    jacobian[-1, [1, 3]] = -height_mm, -1.0
    covariance = jacobian @ spread @ jacobian.T
    by_height = np.zeros(len(mean))
    by_height[[0, -1]] = -dx * height_std_mm, -dz * height_std_mm
    return mean, covariance + np.outer(by_height, by_height)


def _height(axis: Axis, pose_12: FloatArray | None) -> tuple[float, float]:
    """Return the way along the axis from its foot to C1's plane Y = 0, and its uncertainty, mm.

    1T2 tells it to a fraction of a millimetre, which a roll of some degrees makes nothing of.
    """
    if pose_12 is None:
        return 0.0, HEIGHT_STD_MM
    down = rotation(pose_12[:3])[1]
    return float(-(down @ axis.foot + pose_12[4]) / (down @ axis.direction)), 0.0


def _span(problem: SweepProblem) -> float:
    """Return the widest turn before one board, rad."""
    return max(
        float(np.ptp(problem.readings_rad[problem.placement == k]))
        for k in range(problem.placements)
    )


def _images_gate(result: SweepResult) -> Gate:
    """Gate on images that were left out whole, as outliers."""
    left = finite(result.residuals).sum(axis=-1)
    out = [name for name, count in zip(result.images, left, strict=True) if count < MIN_CORNERS]
    return gate(
        "sweep-images",
        not out,
        f"{len(out)} of {len(left)} images contradict the others"
        + (f" and were left out: {', '.join(out)}" if out else ""),
        remedy="check alpha2_deg of these images, that they show this placement, and that the "
        "board stood still; or name them in exclude = [...] of [sweep]",
    )


def _gates(
    result: SweepResult, span: float, stated_rad: float, height_std_mm: float
) -> tuple[Gate, ...]:
    """Return what must hold before the sweep may be used.

    Parameters
    ----------
    span
        Widest turn before one board, rad.
    stated_rad
        Standard uncertainty that is stated for a reading.
    height_std_mm
        Of the way along the axis to C1's plane Y = 0.
    """
    by_height = abs(np.sin(result.gaze_roll_rad)) * height_std_mm
    if by_height > np.sqrt(0.5) * result.eccentricity_std_mm:
        remedy = (
            f"C2 is rolled by {np.degrees(result.gaze_roll_rad):.1f} deg against its yaw axis, so "
            "that e differs along it, and nothing tells the height of C1: add [stereo], or mount "
            "C2 upright"
        )
    else:
        remedy = "sweep further, or before a nearer or larger board"
    worst = int(np.argmax(np.abs(result.reading_errors_rad)))
    error = abs(float(result.reading_errors_rad[worst]))
    limit = max(READING_LIMIT * stated_rad, SMALL_READING_ERROR_RAD)
    return (
        fit_gate(
            "sweep-fit",
            result.residuals,
            result.rejected,
            remedy="check that the board was at rest within each placement, and the readings",
        ),
        _images_gate(result),
        gate(
            "sweep-span",
            span >= MIN_SPAN_RAD,
            f"C2 turned through {np.degrees(span):.1f} deg before one board (at least "
            f"{np.degrees(MIN_SPAN_RAD):.0f} needed)",
            remedy="sweep as far as the board stays in view",
        ),
        gate(
            "sweep-eccentricity",
            result.eccentricity_std_mm <= ECCENTRICITY_STD_LIMIT_MM,
            f"eccentricity {result.eccentricity_mm:z.2f} mm, standard uncertainty "
            f"{result.eccentricity_std_mm:.2f} mm (limit {ECCENTRICITY_STD_LIMIT_MM:g})",
            remedy=remedy,
        ),
        gate(
            "sweep-encoder",
            abs(result.encoder_scale) <= SCALE_LIMIT,
            f"encoder scale error {100 * result.encoder_scale:z.2f} %, standard uncertainty "
            f"{100 * result.encoder_scale_std:.2f} % (limit {100 * SCALE_LIMIT:.0f})",
            remedy="check the unit of alpha2_deg, steps per turn and gear ratio",
        ),
        gate(
            "sweep-readings",
            error <= limit,
            f"readings differ by {np.degrees(error):.3f} deg at most from the turns in the images, "
            f"in {result.images[worst]} (limit {np.degrees(limit):.3f})",
            remedy="check alpha2_deg of this image first, or state u_alpha2_deg in [encoder]",
        ),
    )
