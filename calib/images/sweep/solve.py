"""Solves a yaw sweep: what the images show, where to start, which sense, which outliers."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.core.unit_diagonal import Spectrum
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera
from calib.geometry.poses import pose_matrix, pose_vector, rotation
from calib.images.bundle import Minimum, deformed, dispersion, finite, inverse, minimise, proven
from calib.images.checks import RMS_LIMIT_PX, outlier_limit, require_board
from calib.images.mrcal.solves import MIN_CORNERS
from calib.images.pairs import half_turn_looks_same, single_view_pose
from calib.images.sweep.model import (
    AXIS,
    ENCODER,
    SweepProblem,
    blocks_of,
    image_clusters,
    residuals_of,
)

MIN_READINGS = 3
"""Two readings leave axis and encoder scale open."""

SIGN_RATIO = 3.0
"""How much better the other sense of turning must fit to be called the right one."""

NO_AXIS_RMS_PX = 20.0
"""Beyond, an attempt is far from any minimum, and proves nothing about signs: attempts in the right
sense ended below 5 px on drawn rigs with every error."""

REVERSED_SCALE = 0.5
"""A scale error this near to -2 is the other sense of turning."""

MEASURED_SHARE = 0.5
"""An encoder term counts as measured when the sweep narrows its prior to this share or less."""

FOOT_STD_MM = 200.0
"""C2 is mounted within a hand's breadth of its yaw axis. A sweep of 20 degrees tells 400 times
better; one of a degree cannot distinguish a distant axis from a turn the other way."""

START_SIGMA_PX = 0.1
"""Corner noise assumed before the residuals tell."""

HELD = 1e-4
"""Factor on priors that holds their quantities, against images that pull with a cost of 10^8."""

_ROUNDS = 3
_SMALLEST_STEP = 0.1
_STARTS = 5
_CHECKED = 10


@dataclass(frozen=True)
class SweepReadings:
    """How the images of a sweep were taken.

    Parameters
    ----------
    alpha2_rad
        Encoder readings, shape (n,).
    placements
        Name of the board's placement in each image, n of them.
    resolution_rad
        One count or microstep of the encoder.
    u_alpha2_rad
        Further standard uncertainty of a reading.
    """

    alpha2_rad: FloatArray
    placements: tuple[str, ...]
    resolution_rad: float
    u_alpha2_rad: float

    @property
    def std_rad(self) -> float:
        """Stated standard uncertainty of a reading: the rounding to counts and the rest, rad."""
        return float(np.hypot(self.resolution_rad / np.sqrt(12), self.u_alpha2_rad))


@dataclass(frozen=True)
class SweepSolution:
    """A solved sweep.

    Parameters
    ----------
    problem
        With the noise that the residuals tell, outliers left out, and the priors that remain.
    minimum
        The unknowns.
    spread
        Their covariance under independent noise, shape (n, n).
    dispersion
        How much more the images contradict each other in the axis than that.
    images
        Names of the images used.
    placements
        Names of the placements, in the order of the problem's.
    rejected
        Corners discarded as outliers.
    """

    problem: SweepProblem
    minimum: Minimum
    spread: FloatArray
    dispersion: float
    images: tuple[str, ...]
    placements: tuple[str, ...]
    rejected: int


def solve_sweep(
    corners: Corners,
    readings: SweepReadings,
    board: Board,
    *,
    camera: Camera,
    covariance: FloatArray,
    warp_mm: tuple[float, float] | None,
    priors: Mapping[str, tuple[float, float]],
) -> SweepSolution:
    """Solve a sweep; arguments and errors as in `calib.images.sweep.yaw_axis.yaw_sweep`."""
    kept = np.flatnonzero(finite(corners.pixels).sum(axis=-1) >= MIN_CORNERS)
    alpha2 = readings.alpha2_rad[kept]
    if len(np.unique(alpha2)) < MIN_READINGS:
        raise EstimationError(
            f"sweep: the board was found at {len(np.unique(alpha2))} readings of the encoder and "
            f"{MIN_READINGS} are needed; take images over 20 degrees or more"
        )
    names = [readings.placements[i] for i in kept]
    placements = tuple(dict.fromkeys(names))
    placement = np.array([placements.index(name) for name in names])
    pixels = corners.pixels[kept]
    problem = SweepProblem(
        points=deformed(board.object_points(), warp_mm),
        pixels=_same_end(pixels, placement) if half_turn_looks_same(board) else pixels,
        readings_rad=alpha2,
        placement=placement,
        camera=camera,
        intrinsics_root=root_of(covariance),
        turn_std_rad=readings.std_rad,
        sigma_px=START_SIGMA_PX,
        foot_std_mm=FOOT_STD_MM,
        encoder_prior=tuple(
            priors.get(parameter.name, (0.0, parameter.prior_std or np.inf))
            for parameter, _ in ENCODER
        ),
    )
    _check_board(problem, board)
    refined, minimum = _refined(problem, _in_the_right_sense(problem))
    _check_scale(minimum)
    rejected = int(finite(problem.pixels).sum() - finite(refined.pixels).sum())
    spread = inverse(minimum.normal.matrix)
    return SweepSolution(
        problem=refined,
        minimum=minimum,
        spread=spread,
        dispersion=dispersion(image_clusters(refined, minimum.x), spread, np.arange(AXIS)),
        images=tuple(corners.images[i] for i in kept),
        placements=placements,
        rejected=rejected,
    )


def _same_end(pixels: FloatArray, placement: IntArray) -> FloatArray:
    """Return the corners, read from the end from which the placement's first image was read.

    C2 turns about an axis near its image y axis, so a board at rest stays upright in its images.
    """
    pixels = np.array(pixels)
    along = np.nanmean(np.diff(pixels, axis=1), axis=1)
    for i, k in enumerate(placement):
        first = int(np.argmax(placement == k))
        if along[i] @ along[first] < 0:
            pixels[i] = pixels[i, ::-1]
    return pixels


def root_of(covariance: FloatArray) -> FloatArray:
    """Return A, shape (p, r), with A A' the covariance; r is its rank."""
    return Spectrum.of(covariance).root(least=len(covariance) * np.finfo(float).eps)


def _in_the_right_sense(problem: SweepProblem) -> FloatArray:
    """Return unknowns at which the images fit, or raise EstimationError if they fit backwards.

    The encoder's terms, the readings and the axis' foot are held meanwhile: a scale error of -2 is
    the other sense, too, so are readings that all err, and so is, before one board, an axis twice
    as far away as the board.
    """
    held = replace(
        problem,
        foot_std_mm=HELD * problem.foot_std_mm,
        turn_std_rad=HELD * problem.turn_std_rad,
        encoder_prior=tuple((mean, HELD * std) for mean, std in problem.encoder_prior),
    )
    x, rms = _attempt(held)
    x[problem.at_turns] *= HELD
    if rms <= RMS_LIMIT_PX:
        return x
    _, other = _attempt(held.flipped())
    if min(rms, other) > NO_AXIS_RMS_PX:
        raise EstimationError(_no_axis(rms, other))
    if SIGN_RATIO * other < rms:
        raise EstimationError(
            f"sweep: alpha2 counts the wrong way round: the images fit to {other:.2f} px with the "
            f"sign of the encoder reversed, to {rms:.1f} px as it stands; alpha2 must rise as C2 "
            "turns from -X (towards C1) to +Z (ahead): replace alpha2_deg by 180 - alpha2_deg in "
            "every table; or, if C2 hangs upside down, turn all its pictures by 180 deg instead"
        )
    return x


def _check_scale(minimum: Minimum) -> None:
    """Raise EstimationError if the encoder's scale says that it counts the other way."""
    place = [parameter.name for parameter, _ in ENCODER].index("encoder_scale")
    scale = float(minimum.x[AXIS + place])
    if abs(scale + 2) < REVERSED_SCALE:
        raise EstimationError(
            f"sweep: the images fit with an encoder scale error of {100 * scale:.0f} %, which is "
            "an encoder that counts the wrong way round, or an axis elsewhere: replace alpha2_deg "
            "by 180 - alpha2_deg in every table, or check that it was C2 that turned"
        )


def _no_axis(rms: float, other: float) -> str:
    """Say that no axis near C2 fits; far from any minimum neither sense is the better one."""
    return (
        f"sweep: no axis within {FOOT_STD_MM:g} mm or so of C2's centre fits the images, in "
        f"either sense of the encoder ({rms:.0f} px rms as it stands, {other:.0f} px reversed): "
        "check that the board was at rest within each placement and it was C2 that turned (a "
        "turntable under the board is no sweep), that the yaw axis passes near C2, and the unit of "
        "alpha2_deg"
    )


def _attempt(problem: SweepProblem) -> tuple[FloatArray, float]:
    """Return unknowns and rms, px, at the minimum, or at the start if none is found."""
    x = _start(problem)
    # No minimum is a bad fit; how bad, the start tells.
    with suppress(EstimationError):
        x = minimise(partial(blocks_of, problem), x).x
    return x, float(np.sqrt(np.nanmean(residuals_of(problem, x) ** 2)))


def _start(problem: SweepProblem) -> FloatArray:
    """Return unknowns to start from: an axis through C2's centre, boards by single views.

    Of the single views of a placement the one that predicts the others best is taken.
    """
    x = np.zeros(problem.size)
    for placement in range(problem.placements):
        views = np.flatnonzero(problem.placement == placement)
        tried = views[np.unique(np.linspace(0, len(views) - 1, _STARTS).round().astype(int))]
        proposals = []
        for i in tried:
            pose, _ = single_view_pose(
                problem.camera, points=problem.points, pixels=problem.pixels[i]
            )
            back = np.eye(4)
            back[:3, :3] = rotation(np.array([0.0, problem.turns(x)[0][i], 0.0]))
            x[problem.at_pose(placement)] = pose_vector(back @ pose_matrix(pose))
            miss = float(np.nanmedian(np.abs(residuals_of(problem, x)[views])))
            proposals.append((miss, x[problem.at_pose(placement)].copy()))
        x[problem.at_pose(placement)] = min(proposals, key=lambda one: one[0])[1]
    return x


def _check_board(problem: SweepProblem, board: Board) -> None:
    """Raise EstimationError if single views do not show the stated board."""
    views = problem.pixels[:: max(1, len(problem.pixels) // _CHECKED)]
    errors = [
        single_view_pose(problem.camera, points=problem.points, pixels=view)[1] for view in views
    ]
    require_board(board, np.array(errors), where="sweep")


def _refined(problem: SweepProblem, x: FloatArray) -> tuple[SweepProblem, Minimum]:
    """Return problem and minimum with noise from the residuals, outliers out, priors where needed.

    Encoder terms that the sweep shows lose their priors: what it says of them is then its own. How
    far the readings err is taken from the images, too: a motor that rests on whole counts errs by
    much less than a count.
    """
    try:
        minimum = minimise(partial(blocks_of, problem), x)
    except EstimationError as error:
        raise EstimationError(
            "sweep: no axis fits the images; check that the board was at rest within each "
            f"placement, and the readings ({error})"
        ) from error
    spread = np.sqrt(np.diag(inverse(minimum.normal.matrix)))[AXIS : AXIS + len(ENCODER)]
    problem = replace(
        problem,
        encoder_prior=tuple(
            (mean, np.inf if std < MEASURED_SHARE * wide else wide)
            for (mean, wide), std in zip(problem.encoder_prior, spread, strict=True)
        ),
    )
    for _ in range(_ROUNDS):
        residuals = residuals_of(problem, minimum.x)
        sigma = _sigma(problem, minimum, residuals)
        good = np.abs(residuals).max(axis=-1, keepdims=True) <= outlier_limit(residuals)
        pixels = np.where(good, problem.pixels, np.nan)
        turns = problem.at_turns
        factor = _turn_factor(minimum, turns)
        start = minimum.x.copy()
        start[turns] /= factor
        problem = replace(
            problem, sigma_px=sigma, pixels=pixels, turn_std_rad=problem.turn_std_rad * factor
        )
        minimum = minimise(partial(blocks_of, problem), start)
    return problem, minimum


def _turn_factor(minimum: Minimum, turns: IntArray) -> float:
    """Return the standard deviation of the readings' errors over the one assumed.

    Their variance component: the squares found over the degrees of freedom that the images decide
    (Foerstner 1979; MacKay 1992, doi 10.1162/neco.1992.4.3.415), as far as proven.
    """
    freedom = len(turns) - float(np.diag(inverse(minimum.normal.matrix))[turns].sum())
    if freedom < 1:
        return 1.0
    ratio = float((minimum.x[turns] ** 2).sum()) / freedom
    return max(_SMALLEST_STEP, float(np.sqrt(proven(ratio, freedom=freedom))))


def _sigma(problem: SweepProblem, minimum: Minimum, residuals: FloatArray) -> float:
    """Return the standard deviation of a corner coordinate, px.

    The degrees of freedom that the unknowns use up are counted less the part that priors decide,
    which is the trace of covariance times prior precision.
    """
    covariance = np.diag(inverse(minimum.normal.matrix))
    _, std = np.array(problem.encoder_prior).T
    decided = float((covariance[AXIS : AXIS + len(ENCODER)] / std**2).sum())
    for columns in (problem.at_intrinsics, problem.at_turns):
        decided += float(covariance[columns].sum())
    freedom = np.isfinite(residuals).sum() - (problem.size - decided)
    return float(np.sqrt(np.nansum(residuals**2) / max(freedom, 1.0)))
