"""Stage: the stereo reference, C2 held at one yaw.

Pairs of board images give 1T2, the pose of C2 in C1 (P1 = R P2 + t), and with it the position of
the gazed corner in each pair: the depths that the gaze rows are calibrated against.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.core.gate import Gate
from calib.geometry.board import Board, Corners
from calib.geometry.poses import pose_matrix, pose_vector, rotation
from calib.images.bundle import finite
from calib.images.checks import fit_gate, gate
from calib.images.mrcal.call import MrcalMissingError
from calib.images.pairs import MIN_PAIRS, PairStart, start_pairs
from calib.images.stereo.solve import (
    CameraPair,
    StereoSolve,
    joint_covariance,
    solve_mrcal,
    solve_mrcal_free,
    solve_opencv,
)
from calib.images.stereo.triangulate import Targets, find_targets

AGREEMENT_CHI2 = 22.5
"""0.999 quantile of chi squared with 6 degrees of freedom."""

DEPTH_STD_LIMIT = 0.02
"""Relative standard uncertainty beyond which a depth is no reference: active gazing itself is good
to 1 to 8 % (Xu and Wang, Table 2)."""

BOARD_POSE_SIGMAS = 5.0
"""Of 100 normal errors the largest is 2.6 standard deviations; corners of real boards are less
normal than that."""

ROLL_LIMIT_RAD = float(np.deg2rad(45.0))
"""Beyond, C2's centre column is nearer to a row of C1. The model's roll is a degree or two."""

NO_POSE_RMS_PX = 5.0
"""Pairs that belong together fit to a fraction of a pixel, with poor intrinsics to some; whatever a
pose says that misses them by more, that C2 stands on the other side or upside down, it says by
chance."""

INCONSISTENT_SHARE = 0.5
"""Of a pair's corners rejected: above it not a corner is wrong but the pair. Two pictures that were
not taken together, or one upside down, keep a corner or two by chance."""

GIVEN_SIGMA_PX = 0.1
"""Standard deviation of a corner coordinate where 1T2 is given and no solve tells it."""


@dataclass(frozen=True)
class StereoReference:
    """The pose of C2 in C1, and the target in each pair.

    Parameters
    ----------
    source
        "mrcal", "opencv" or "given": whose pose it is.
    stems
        Names of the pairs used.
    turned
        Those whose board C2's image gave from the other end.
    transform_12
        Pose of C2 in C1, P1 = R P2 + t, mm, shape (4, 4).
    pose_12
        The same as rotation vector, rad, and translation, mm, shape (6,).
    covariance
        Of `pose_12`, corner noise and intrinsics, shape (6, 6).
    baseline_mm, baseline_std_mm
        Distance of the centres of C1 and C2, with its standard uncertainty.
    rms_px
        Root mean square of the residual per coordinate over inliers; NaN if 1T2 is given.
    solves
        The backends side by side, the one of record first; empty if 1T2 is given.
    targets
        The gazed corner in each pair.
    gates
        What must hold before the reference may be used.
    """

    source: str
    stems: tuple[str, ...]
    turned: tuple[str, ...]
    transform_12: FloatArray
    pose_12: FloatArray
    covariance: FloatArray
    baseline_mm: float
    baseline_std_mm: float
    rms_px: float
    solves: tuple[StereoSolve, ...]
    targets: Targets
    gates: tuple[Gate, ...]


def stereo_reference(
    corners: tuple[Corners, Corners],
    board: Board,
    rig: CameraPair,
    *,
    stems: tuple[str, ...],
    seed: int,
) -> StereoReference:
    """Solve 1T2 by both backends and triangulate the target of each pair.

    Parameters
    ----------
    corners
        Of C1 and C2; view i of both is the pair ``stems[i]``.
    rig
        The cameras with the covariance of their intrinsics, which are held.
    seed
        Of mrcal's random numbers.

    Raises
    ------
    EstimationError
        If there are too few pairs, or they cannot be pairs of this rig: a board miscounted, C1 and
        C2 swapped, C2 upside down, pictures that were not taken together.
    """
    start = start_pairs(corners, board, cameras=rig.cameras)
    solves, backend_gates = _solve(start, board, rig, seed)
    inconsistent = _inconsistent_pairs(start, solves)
    pairs_gate = _pairs_gate(tuple(stems[i] for i in start.pairs[inconsistent]), len(inconsistent))
    if inconsistent.any() and np.sum(~inconsistent) >= MIN_PAIRS:
        start = start.keep(~inconsistent)
        solves, backend_gates = _solve(start, board, rig, seed)
    record = solves[0]
    _check_together(record)
    _check_mounting(record.pose_12, is_left=rig.is_left)
    used = tuple(stems[i] for i in start.pairs)
    targets = find_targets(
        start.pixels,
        board,
        cameras=rig.cameras,
        stems=used,
        pose_12=record.pose_12,
        shared_covariance=joint_covariance(rig, record),
        sigma_px=record.sigma_px,
        warp_mm=record.board_warp_mm,
    )
    fit = fit_gate(
        "stereo-fit",
        record.residuals,
        record.rejected,
        remedy="check the counts and the square of [board], that pairs of one stem were taken "
        "together, and the intrinsics",
    )
    return _reference(
        source=record.backend,
        stems=used,
        turned=tuple(used[i] for i in np.flatnonzero(start.turned)),
        pose_12=record.pose_12,
        covariance=record.covariance,
        solves=solves,
        targets=targets,
        gates=(fit, pairs_gate, *backend_gates),
    )


def given_reference(
    corners: tuple[Corners, Corners],
    board: Board,
    rig: CameraPair,
    *,
    stems: tuple[str, ...],
    transform_12: FloatArray,
) -> StereoReference:
    """Take 1T2 as given, without uncertainty, and triangulate the target of each pair.

    Parameters
    ----------
    corners, stems
        As in `stereo_reference`; no views at all will do.
    transform_12
        Pose of C2 in C1, P1 = R P2 + t, mm, shape (4, 4).

    Raises
    ------
    EstimationError
        If C1 and C2 are swapped, C2 is upside down, or the rays of a pair do not meet.
    """
    pose_12 = pose_vector(transform_12)
    _check_mounting(pose_12, is_left=rig.is_left)
    edge = sum(len(c) for c in rig.covariances)
    shared = np.zeros((edge + 6, edge + 6))
    for first, covariance in zip((0, len(rig.covariances[0])), rig.covariances, strict=True):
        place = slice(first, first + len(covariance))
        shared[place, place] = covariance
    targets = find_targets(
        np.stack([c.pixels for c in corners]),
        board,
        cameras=rig.cameras,
        stems=stems,
        pose_12=pose_12,
        shared_covariance=shared,
        sigma_px=GIVEN_SIGMA_PX,
        warp_mm=None,
    )
    return _reference(
        source="given",
        stems=stems,
        turned=(),
        pose_12=pose_12,
        covariance=np.zeros((6, 6)),
        solves=(),
        targets=targets,
        gates=(),
    )


def _reference(
    *,
    source: str,
    stems: tuple[str, ...],
    turned: tuple[str, ...],
    pose_12: FloatArray,
    covariance: FloatArray,
    solves: tuple[StereoSolve, ...],
    targets: Targets,
    gates: tuple[Gate, ...],
) -> StereoReference:
    """Return the result with what follows from the pose and the targets."""
    shift = pose_12[3:]
    baseline = float(np.linalg.norm(shift))
    along = shift / baseline
    return StereoReference(
        source=source,
        stems=stems,
        turned=turned,
        transform_12=pose_matrix(pose_12),
        pose_12=pose_12,
        covariance=covariance,
        baseline_mm=baseline,
        baseline_std_mm=float(np.sqrt(along @ covariance[3:, 3:] @ along)),
        rms_px=solves[0].rms_px if solves else float("nan"),
        solves=solves,
        targets=targets,
        gates=(*gates, *_target_gates(targets)),
    )


def _solve(
    start: PairStart, board: Board, rig: CameraPair, seed: int
) -> tuple[tuple[StereoSolve, ...], tuple[Gate, ...]]:
    """Return the solves, the one of record first, and the gates on their agreement."""
    with ThreadPoolExecutor(2) as pool:
        held = pool.submit(solve_mrcal, start, board, rig, seed=seed)
        free = pool.submit(solve_mrcal_free, start, board, rig, seed=seed)
        plain = solve_opencv(start, board, rig)
    try:
        record = held.result()
    except MrcalMissingError as error:
        return (plain,), (Gate("stereo-backends", True, str(error)),)
    except EstimationError as error:
        alone = f"OpenCV alone, the cross-check is missing: {error}"
        return (plain,), (Gate("stereo-backends", False, alone),)
    agreement = _agreement_gate(record, plain)
    try:
        joint = free.result()
    except EstimationError:  # too few pairs for intrinsics of their own
        return (record, plain), (agreement,)
    return (record, plain, joint), (agreement, _intrinsics_gate(record, joint))


def _inconsistent_pairs(start: PairStart, solves: tuple[StereoSolve, ...]) -> BoolArray:
    """Return which pairs do not fit the pose that the others share, shape (n,)."""
    plain = next(solve for solve in solves if solve.backend == "opencv")
    shown = finite(start.pixels).all(axis=0).sum(axis=-1)
    kept = finite(plain.residuals).all(axis=0).sum(axis=-1)
    inconsistent: BoolArray = np.asarray(shown - kept > INCONSISTENT_SHARE * shown)
    return inconsistent


def _pairs_gate(inconsistent: tuple[str, ...], count: int) -> Gate:
    """Gate on pairs that contradict the others."""
    if not inconsistent:
        return Gate("stereo-pairs", True, f"all {count} pairs fit one pose of C2")
    return Gate(
        "stereo-pairs",
        False,
        f"{len(inconsistent)} of {count} pairs do not fit the pose of C2 that the others share: "
        f"{', '.join(inconsistent)}; look whether their two pictures were taken together, of C1 "
        "and C2 in this order, none turned, with C2 at its yaw; mend them, or name one picture of "
        "each in exclude = [...] of [stereo]",
    )


def _check_together(record: StereoSolve) -> None:
    """Raise EstimationError if the pairs fit no pose at all."""
    if record.rms_px > NO_POSE_RMS_PX:
        raise EstimationError(
            f"stereo: the pairs fit no single pose of C2, rms {record.rms_px:.1f} px: check that "
            "pictures of one name were taken together and C2 was at rest, that [stereo] c1 and c2 "
            "are not exchanged, and that the intrinsics are these cameras'"
        )


def _check_mounting(pose_12: FloatArray, *, is_left: bool) -> None:
    """Raise EstimationError unless C2 stands on its side of C1, at +X or at -X, upright."""
    x = float(pose_12[3])
    if not (x < 0 if is_left else x > 0):
        other = "right" if is_left else "left"
        raise EstimationError(
            f"stereo: C2 stands at X = {x:.1f} mm of C1, on its {other}: if the turning camera "
            f'does stand there, write c2 = "{other}" in [rig]; if not, C1 and C2 are swapped (C2 '
            "is the turning camera): exchange [stereo] c1 and c2, and [cameras] with them"
        )
    along = rotation(pose_12[:3])
    roll = float(np.arctan2(along[1, 0], along[1, 1]))
    if abs(roll) > ROLL_LIMIT_RAD:
        raise EstimationError(
            f"stereo: C2's pictures stand turned by {np.degrees(roll):.0f} deg against C1's: turn "
            "all pictures of C2 (intrinsics, pairs, rows, sweep) until what is up in C1 is up in "
            "C2, and state what follows from pixels (model, u2_px) for the turned ones"
        )


def _agreement_gate(record: StereoSolve, plain: StereoSolve) -> Gate:
    """Gate on the agreement of mrcal and OpenCV, which see the same corners and intrinsics."""
    chi2 = _chi2(record, plain)
    x, y = record.board_warp_mm or (0.0, 0.0)
    return gate(
        "stereo-backends",
        chi2 <= AGREEMENT_CHI2,
        f"mrcal and OpenCV differ by {_difference(record, plain)}, chi2 {chi2:.1f} of 6; rms "
        f"{record.rms_px:.3f} and {plain.rms_px:.3f} px; mrcal finds the board deformed by "
        f"{x:z.2f} mm along x and {y:z.2f} mm along y, OpenCV takes it to be flat",
        remedy="if the deformation is large use a stiffer board, else look for misread boards "
        "in the pairs",
    )


def _intrinsics_gate(record: StereoSolve, joint: StereoSolve) -> Gate:
    """Gate on the pairs' own opinion of the intrinsics."""
    chi2 = _chi2(record, joint, with_intrinsics=True)
    return gate(
        "stereo-intrinsics",
        chi2 <= AGREEMENT_CHI2,
        f"with intrinsics from the pairs alone the pose differs by {_difference(record, joint)}, "
        f"chi2 {chi2:.1f} of 6",
        remedy="the pairs contradict the intrinsics: was a lens refocused or moved in between?",
    )


def _target_gates(targets: Targets) -> tuple[Gate, ...]:
    """Gates on the targets' depths: sharp enough, and confirmed by the board's pose in C1."""
    if not targets.stems:
        return ()
    share = targets.depth_std_mm / targets.triangulated.position_mm[:, 2]
    worst, far = int(np.argmax(share)), int(np.argmax(np.abs(targets.board_sigmas)))
    apart = float(targets.board_sigmas[far])
    depth = targets.triangulated.position_mm[far, 2]
    other = targets.by_board.position_mm[far, 2]
    return (
        gate(
            "stereo-depth",
            share[worst] <= DEPTH_STD_LIMIT,
            f"u(z)/z is {100 * share[worst]:.2f} % at worst, in pair {targets.stems[worst]} (limit "
            f"{100 * DEPTH_STD_LIMIT:.0f})",
            remedy="take more pairs, tilted and spread over depth and image",
        ),
        gate(
            "stereo-board-pose",
            abs(apart) <= BOARD_POSE_SIGMAS,
            f"triangulated depth and board pose in C1 differ most in pair {targets.stems[far]}: "
            f"{depth:.2f} and {other:.2f} mm, {apart:z.1f} standard deviations (limit "
            f"{BOARD_POSE_SIGMAS:g})",
            remedy="check square_mm, 1T2 and the intrinsics",
        ),
    )


def _chi2(one: StereoSolve, two: StereoSolve, *, with_intrinsics: bool = False) -> float:
    """Return the squared difference of two poses in their standard deviations.

    Two solves of the same corners share much of their errors, so this is on the low side.
    """
    difference = one.pose_12 - two.pose_12
    if with_intrinsics:
        spread = one.covariance + two.covariance
    else:
        spread = one.noise_covariance + two.noise_covariance
    return float(difference @ np.linalg.solve(spread, difference))


def _difference(one: StereoSolve, two: StereoSolve) -> str:
    difference = np.abs(one.pose_12 - two.pose_12)
    return f"{1e3 * difference[:3].max():.2f} mrad and {difference[3:].max():.2f} mm"
