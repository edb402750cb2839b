"""What must hold before a stereo reference may be used."""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.gate import Gate
from calib.geometry.board import Board
from calib.images.checks import gate
from calib.images.joint.changes import FocalChange, focal_changes
from calib.images.joint.drifts import CentreShift, PoseDrift, centre_shifts, pose_drift
from calib.images.joint.solve import JointSolve
from calib.images.pairs import PairStart
from calib.images.stereo.solve import StereoSolve
from calib.images.stereo.triangulate import PairTargets, midpoints

AGREEMENT_CHI2 = 22.5
"""0.999 quantile of chi squared with 6 degrees of freedom."""

DEPTH_AGREEMENT = 0.003
"""Relative difference in depth by which backends may differ, however uncertain they say they are:
active gazing itself is good to 1 to 8 % (Xu and Wang, Table 2)."""

FOCAL_CHANGE, FOCAL_SIGMAS = 0.001, 3.3
"""Relative change of a focal length between pictures that may be: depth inherits it. And what it
must be of its uncertainty: 1 in 1,000 by chance, with some six looked at in a run."""

STEADY_TURN_RAD = 1e-4
"""Turn of C2 against C1 that may be: a tenth of what a row's gaze is good to."""

DEPTH_STD_LIMIT = 0.02
"""Relative standard uncertainty beyond which a depth is no reference: active gazing itself is good
to 1 to 8 % (Xu and Wang, Table 2)."""

BOARD_POSE_SIGMAS = 5.0
"""Of 100 normal errors the largest is 2.6 standard deviations; corners of real boards are less
normal than that."""


def pairs_gate(inconsistent: tuple[str, ...], count: int) -> Gate:
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


def agreement_gate(
    record: StereoSolve,
    others: tuple[StereoSolve, ...],
    start: PairStart,
    board: Board,
    missing: tuple[str, ...] = (),
) -> Gate:
    """Gate on other backends: each must find the same depths, mrcal the same pose too.

    OpenCV takes the board to be flat, so that it differs in the pose by what a warp does. `missing`
    says of backends why they are not among them.
    """
    passed, told = True, list(missing)
    for other in others:
        apart = depth_difference(record, other, start, board)
        passed &= apart <= DEPTH_AGREEMENT
        text = f"{other.backend} ({_basis(other)}) differs by {difference(record, other)}"
        if other.backend == "mrcal":
            chi2 = squared_difference(record, other)
            passed &= chi2 <= AGREEMENT_CHI2
            text += f", chi2 {chi2:.1f} of 6 (limit {AGREEMENT_CHI2:g})"
        told.append(
            f"{text}, by {100 * apart:.3f} % in depth (limit {100 * DEPTH_AGREEMENT:g}), rms "
            f"{other.rms_px:.3f} px"
        )
    x, y = record.board_warp_mm or (0.0, 0.0)
    return gate(
        "stereo-backends",
        passed,
        f"rms of the joint solve {record.rms_px:.3f} px, board deformed by {x:z.2f} mm along x and "
        f"{y:z.2f} mm along y; " + "; ".join(told),
        remedy="if the deformation is large use a stiffer board, else look for misread boards "
        "in the pairs, and take more pairs, tilted and spread over depth and image",
    )


def _basis(solve: StereoSolve) -> str:
    lens = "all lenses solved" if solve.intrinsics == "free" else "lenses held"
    return lens if solve.board_warp_mm is not None else f"{lens}, flat board"


def intrinsics_gate(held: StereoSolve, alone: StereoSolve) -> Gate:
    """Gate on the pairs' own opinion of the intrinsics, against that of the lens pictures."""
    chi2 = squared_difference(held, alone, both=True)
    return gate(
        "stereo-intrinsics",
        chi2 <= AGREEMENT_CHI2,
        f"with intrinsics from the pairs alone the pose differs by {difference(held, alone)} from "
        f"that with intrinsics from their own pictures, chi2 {chi2:.1f} of 6",
        remedy="the pairs contradict the intrinsics: was a lens refocused or moved in between?",
    )


def lens_gates(changes: tuple[FocalChange, ...]) -> tuple[Gate, ...]:
    """Gates on the focal length of each camera being the same in all its pictures.

    Pairs tie both cameras together, so that a change of one shows in the other, too, but less: of
    two that were estimated each alone, the one with the larger change in standard uncertainties
    fails.
    """
    worst = max((abs(c.change) / c.std for c in changes), default=0.0)
    gates = []
    for camera in dict.fromkeys(change.camera for change in changes):
        own = [change for change in changes if change.camera == camera]
        bad = [c for c in own if abs(c.change) > max(FOCAL_CHANGE, FOCAL_SIGMAS * c.std)]
        told = "; ".join(_change_words(change) for change in bad or own)
        gates.append(
            gate(
                f"{camera}-one-lens",
                not any(c.together or abs(c.change) / c.std >= worst for c in bad),
                f"{told} (limit {100 * FOCAL_CHANGE:g} % and {FOCAL_SIGMAS:g} u)",
                remedy="a lens that changes with focus or distance cannot be one camera: switch "
                "autofocus off, fix focus, zoom and crop, and take the lens pictures at the "
                "distances and in the state of the rows",
            )
        )
    return tuple(gates)


def _change_words(change: FocalChange) -> str:
    if change.between == "distance":
        where = "between the farthest and the nearest board"
    else:
        where = f"in the pictures of {change.between}s against the others"
    return (
        f"focal length of {change.camera.upper()} {100 * change.change:+.3f} % +- "
        f"{100 * change.std:.3f} % {where}"
    )


def joint_gates(joint: JointSolve) -> tuple[Gate, ...]:
    """Gates on lenses, crops and rig being the same in all pictures."""
    steady = steady_gates(centre_shifts(joint), pose_drift(joint))
    return (*lens_gates(focal_changes(joint)), *steady)


def steady_gates(shifts: tuple[CentreShift, ...], drift: PoseDrift | None) -> tuple[Gate, ...]:
    """Gates on crops that stay the same, and on a pose of C2 that does not drift."""
    gates = []
    for shift in shifts:
        size = float(np.linalg.norm(shift.shift_px))
        u, v = shift.shift_px
        told = (
            f"principal point of {shift.camera.upper()} by ({u:+.2f}, {v:+.2f}) px +- "
            f"({shift.std_px[0]:.2f}, {shift.std_px[1]:.2f}) elsewhere in the pictures of "
            f"{shift.kind}s, chi2 {shift.chi2:.1f} of 2 (limit {shift.limit:.3g})"
        )
        moved = shift.chi2 > shift.limit and size > FOCAL_CHANGE * shift.focal_px
        remedy = (
            "another crop (region of interest, binning, video mode) or a lens that was touched: "
            "take all pictures in one mode"
        )
        gates.append(gate(f"{shift.camera}-{shift.kind}s-crop", not moved, told, remedy=remedy))
    if drift is not None:
        turn, shifted = (float(np.linalg.norm(v)) for v in (drift.turn_rad, drift.shift_mm))
        moved = drift.chi2 > drift.limit and turn > STEADY_TURN_RAD
        gates.append(
            gate(
                "stereo-steady",
                not moved,
                f"from the first pair to the last C2 turns against C1 by {1e3 * turn:.2f} mrad "
                f"and moves by {shifted:.2f} mm, chi2 {drift.chi2:.1f} of 6 "
                f"(limit {drift.limit:.3g})",
                remedy="a camera or its mount creeps (C1 loose, the tripod warming up, a cable "
                "that pulls): fasten it, wait, and take the pairs again",
            )
        )
    return tuple(gates)


def target_gates(targets: PairTargets) -> tuple[Gate, ...]:
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


def depth_difference(one: StereoSolve, two: StereoSolve, start: PairStart, board: Board) -> float:
    """Return the greatest relative difference of the depths of the pairs' targets."""
    depths = []
    for solve in (one, two):
        points = start.pixels[:, :, board.target_index]
        used = np.isfinite(points).all(axis=(0, -1))
        depths.append(midpoints(points[:, used], solve.cameras, solve.pose_12)[:, 2])
    return float(np.abs(depths[1] / depths[0] - 1).max()) if len(depths[0]) else 0.0


def squared_difference(one: StereoSolve, two: StereoSolve, *, both: bool = False) -> float:
    """Return the squared difference of two poses in standard deviations.

    Parameters
    ----------
    both
        Whether the two have errors of their own; else they see the same corners, and the
        covariance of the first counts.
    """
    apart: FloatArray = one.pose_12 - two.pose_12
    spread = _by_noise(one) + _by_noise(two) if both else _by_noise(one)
    return float(apart @ np.linalg.solve(spread, apart))


def _by_noise(solve: StereoSolve) -> FloatArray:
    """Return the covariance of a pose without what lenses that breathe might add: (6, 6)."""
    return solve.covariance if solve.intrinsics == "held" else solve.noise_covariance


def difference(one: StereoSolve, two: StereoSolve) -> str:
    """Return how far two poses are apart, in words."""
    apart = np.abs(one.pose_12 - two.pose_12)
    return f"{1e3 * apart[:3].max():.2f} mrad and {apart[3:].max():.2f} mm"
