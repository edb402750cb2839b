"""Stage: the stereo reference, C2 held at one yaw.

Pairs of board images give 1T2, the pose of C2 in C1 (P1 = R P2 + t), and with it the position of
the gazed corner in each pair: the depths that the gaze rows are calibrated against.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.core.gate import Gate
from calib.geometry.board import Board, Corners
from calib.geometry.poses import pose_matrix, pose_vector, rotation
from calib.images.bundle import finite
from calib.images.checks import fit_gate
from calib.images.joint.gather import Extra
from calib.images.joint.lens import RefinedLens, refined_lenses
from calib.images.joint.solve import JointSolve
from calib.images.mrcal.call import MrcalMissingError
from calib.images.pairs import MIN_PAIRS, PairStart, start_pairs
from calib.images.stereo.backends import (
    as_stereo,
    nothing_besides,
    solve_held,
    solve_jointly,
    solve_mrcal_jointly,
    solve_pairs_alone,
)
from calib.images.stereo.by_opencv import opencv_beside
from calib.images.stereo.gates import (
    agreement_gate,
    intrinsics_gate,
    joint_gates,
    pairs_gate,
    target_gates,
)
from calib.images.stereo.solve import (
    CameraPair,
    StereoSolve,
    joint_covariance,
    solve_mrcal,
)
from calib.images.stereo.triangulate import PairTargets, find_targets
from calib.images.stereo.wide import any_wide

ROLL_LIMIT_RAD = float(np.deg2rad(45.0))
"""Beyond, C2's centre column is nearer to a row of C1. The model's roll is a degree or two."""

NO_POSE_RMS_PX = 5.0
"""Pairs that belong together fit to a fraction of a pixel, with poor intrinsics to some; whatever a
pose says that misses them by more, that C2 stands on the other side or upside down, it says by
chance."""

INCONSISTENT_SHARE = 0.5
"""Of a pair's corners rejected: above it not a corner is wrong but the pair. Two pictures that were
not taken together, or one upside down, keep a corner or two by chance."""

MIN_VIEWS = 6
"""Pictures of the lenses alone without which they have no opinion of their own."""

GIVEN_SIGMA_PX = 0.1
"""Standard deviation of a corner coordinate where 1T2 is given and no solve tells it."""


@dataclass(frozen=True)
class StereoReference:
    """The pose of C2 in C1, and the target in each pair.

    Parameters
    ----------
    source
        "joint" or "given": whose pose it is.
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
    lenses
        Those of the cameras whose intrinsics the joint solve found, C1 before C2.
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
    targets: PairTargets
    gates: tuple[Gate, ...]
    lenses: tuple[RefinedLens, ...]


def stereo_reference(
    corners: tuple[Corners, Corners],
    board: Board,
    rig: CameraPair,
    *,
    stems: tuple[str, ...],
    seed: int,
    extra: tuple[Extra, Extra] | None = None,
) -> StereoReference:
    """Solve 1T2 and the lenses from all board images, and triangulate the target of each pair.

    mrcal (on the same images) and OpenCV (on the pairs, the board flat) stand beside it as checks,
    and so does the pose with the lenses held at what their own pictures gave.

    Parameters
    ----------
    corners
        Of C1 and C2; view i of both is the pair ``stems[i]``.
    rig
        The cameras with the covariance of their intrinsics as their own pictures gave them; those
        that are not `free` are held.
    seed
        Of mrcal's random numbers.
    extra
        Further images of the board by C1 and by C2; none by default.

    Raises
    ------
    EstimationError
        If there are too few pairs, or they cannot be pairs of this rig: a board miscounted, C1 and
        C2 swapped, C2 upside down, pictures that were not taken together.
    """
    if extra is None:
        extra = nothing_besides(corners)
    start = start_pairs(corners, board, cameras=rig.cameras)
    record, joint, open_lens = _solve(start, corners, extra, board, rig)
    inconsistent = _inconsistent_pairs(start, record)
    gates = [pairs_gate(tuple(stems[i] for i in start.pairs[inconsistent]), len(inconsistent))]
    if inconsistent.any() and np.sum(~inconsistent) >= MIN_PAIRS:
        start = start.keep(~inconsistent)
        record, joint, open_lens = _solve(start, corners, extra, board, rig)
    _check_together(record)
    _check_mounting(record.pose_12, is_left=rig.is_left)
    if open_lens:
        gates.append(
            Gate("stereo-joint", False, f"no joint solve of lenses and pairs: {open_lens}")
        )
    steady = () if joint is None else joint_gates(joint)
    others, backend_gates = _checks(record, joint, start, corners, board, rig, seed)
    used = tuple(stems[i] for i in start.pairs)
    targets = find_targets(
        start.pixels,
        board,
        cameras=record.cameras,
        stems=used,
        pose_12=record.pose_12,
        shared_covariance=(
            joint_covariance(rig, record) if joint is None else joint.full_covariance()
        ),
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
        solves=(record, *others),
        targets=targets,
        gates=(fit, *gates, *backend_gates, *steady),
        lenses=() if joint is None else refined_lenses(joint),
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
        lenses=(),
    )


def _reference(
    *,
    source: str,
    stems: tuple[str, ...],
    turned: tuple[str, ...],
    pose_12: FloatArray,
    covariance: FloatArray,
    solves: tuple[StereoSolve, ...],
    targets: PairTargets,
    gates: tuple[Gate, ...],
    lenses: tuple[RefinedLens, ...],
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
        gates=(*gates, *target_gates(targets)),
        lenses=lenses,
    )


def _solve(
    start: PairStart,
    corners: tuple[Corners, Corners],
    extra: tuple[Extra, Extra],
    board: Board,
    rig: CameraPair,
) -> tuple[StereoSolve, JointSolve | None, str]:
    """Return the solve of record, the joint one, or why there is none."""
    if not any(rig.free):
        return solve_held(start, corners, board, rig), None, ""
    try:
        joint = solve_jointly(start, corners, extra, board, rig)
    except EstimationError as error:
        return solve_held(start, corners, board, rig), None, str(error)
    return as_stereo(joint, len(start.pairs)), joint, ""


def _checks(
    record: StereoSolve,
    joint: JointSolve | None,
    start: PairStart,
    corners: tuple[Corners, Corners],
    board: Board,
    rig: CameraPair,
    seed: int,
) -> tuple[tuple[StereoSolve, ...], tuple[Gate, ...]]:
    """Return what stands beside the solve of record, and the gates on it."""
    known = replace(rig, cameras=record.cameras)
    with ThreadPoolExecutor(1) as pool:
        if joint is not None and all(rig.free) and not any_wide(rig.cameras):
            waiting = pool.submit(solve_mrcal_jointly, joint, board, seed=seed)
        else:
            waiting = pool.submit(solve_mrcal, start, board, known, seed=seed)
        others, missing = opencv_beside(start, board, known)
        held = record
        if joint is not None:
            held = solve_held(start, corners, board, rig)
            others.append(held)
        gates = [_intrinsics(held, joint, start, corners, board, rig)]
        try:
            others.insert(0, waiting.result())
        except MrcalMissingError as error:
            alone = "; ".join([str(error), *missing])
            return tuple(others), (Gate("stereo-backends", True, alone), *gates)
        except EstimationError as error:
            alone = f"no solution by mrcal, the cross-check is missing: {error}"
            return tuple(others), (Gate("stereo-backends", False, alone), *gates)
    checks = tuple(other for other in others if other is not held)
    return tuple(others), (agreement_gate(record, checks, start, board, missing), *gates)


def _intrinsics(
    held: StereoSolve,
    joint: JointSolve | None,
    start: PairStart,
    corners: tuple[Corners, Corners],
    board: Board,
    rig: CameraPair,
) -> Gate:
    """Compare the intrinsics as held, given or of the lens pictures, with those of the pairs."""
    kinds = () if joint is None else joint.problem.images.kinds
    if joint is not None and kinds.count("lens") < MIN_VIEWS:
        same = (
            "the pictures of the lenses are those of the pairs, so that they cannot contradict "
            "each other"
        )
        return Gate("stereo-intrinsics", True, same)
    try:
        alone = solve_pairs_alone(start, corners, board, replace(rig, free=(True, True)))
    except EstimationError:
        few = "the pairs by themselves are too few for intrinsics of their own"
        return Gate("stereo-intrinsics", True, few)
    return intrinsics_gate(held, alone)


def _inconsistent_pairs(start: PairStart, record: StereoSolve) -> BoolArray:
    """Return which pairs do not fit the pose that the others share, shape (n,)."""
    shown = finite(start.pixels).sum(axis=-1)
    kept = finite(record.residuals).sum(axis=-1)
    lost: BoolArray = np.asarray((shown - kept > INCONSISTENT_SHARE * shown).any(axis=0))
    return lost


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
