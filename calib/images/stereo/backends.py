"""The pose of C2 in C1 by the joint solve of lenses and pairs, and by what stands beside it."""

from __future__ import annotations

import numpy as np

from calib.geometry.board import Board, Corners
from calib.geometry.camera import camera_from_vector
from calib.images.bundle import finite
from calib.images.joint.gather import Extra, gather
from calib.images.joint.solve import JointSolve, solve_joint
from calib.images.mrcal import solves
from calib.images.pairs import PairStart
from calib.images.stereo.solve import (
    CameraPair,
    StereoSolve,
    from_mrcal,
    with_covariance,
)

JOINT = "joint"
"""Backend of this program's own solve."""


def nothing_besides(pairs: tuple[Corners, Corners]) -> tuple[Extra, Extra]:
    """Return no images besides those of the pairs."""
    none = (pairs[0].select(()), pairs[1].select(()))
    return Extra(none[0], none[0]), Extra(none[1], none[1])


def solve_jointly(
    start: PairStart,
    pairs: tuple[Corners, Corners],
    extra: tuple[Extra, Extra],
    board: Board,
    rig: CameraPair,
) -> JointSolve:
    """Solve lenses, pose of C2 and board deformation from all images.

    Raises
    ------
    EstimationError
        If there is no minimum, or the images leave an unknown open.
    """
    problem, at = gather(start, pairs, extra, board, cameras=rig.cameras, free=rig.free)
    return solve_joint(problem, at)


def solve_held(
    start: PairStart, pairs: tuple[Corners, Corners], board: Board, rig: CameraPair
) -> StereoSolve:
    """Solve pose and warp from the pairs with the lenses held, their uncertainty carried through.

    Raises
    ------
    EstimationError
        As `solve_jointly`.
    """
    nothing = nothing_besides(pairs)
    problem, at = gather(start, pairs, nothing, board, cameras=rig.cameras, free=(False, False))
    solve = as_stereo(solve_joint(problem, at), len(start.pairs), intrinsics="held")
    return with_covariance(solve, board, rig, warp_free=True)


def solve_pairs_alone(
    start: PairStart, pairs: tuple[Corners, Corners], board: Board, rig: CameraPair
) -> StereoSolve:
    """Solve all from the pairs alone.

    Raises
    ------
    EstimationError
        As `solve_jointly`; pairs often leave a lens open.
    """
    joint = solve_jointly(start, pairs, nothing_besides(pairs), board, rig)
    return as_stereo(joint, len(start.pairs), intrinsics="from the pairs alone")


def as_stereo(joint: JointSolve, pairs: int, *, intrinsics: str = "free") -> StereoSolve:
    """Return the pose of a joint solve, with the residuals of its first images, the pairs'."""
    residuals = joint.residuals[: 2 * pairs]
    by_pair = residuals.reshape(pairs, 2, *residuals.shape[1:]).swapaxes(0, 1)
    at = joint.problem.at_pose
    inside = np.ix_(at, at)
    sigma = [s for name, s in joint.sigma_px.items() if name.endswith("pair")]
    return StereoSolve(
        backend=JOINT,
        intrinsics=intrinsics,
        pose_12=joint.pose_12,
        covariance=joint.covariance[inside],
        noise_covariance=joint.covariance[inside] - joint.allowance[inside],
        dispersion=joint.factors[2],
        by_intrinsics=np.zeros((6, 0)),
        rms_px=float(np.sqrt(np.nanmean(by_pair**2))),
        sigma_px=float(np.sqrt(np.mean(np.square(sigma)))),
        residuals=by_pair,
        poses=joint.poses[:pairs],
        rejected=int(joint.rejected[: 2 * pairs].sum()),
        board_warp_mm=joint.board_warp_mm,
        cameras=joint.cameras,
    )


def solve_mrcal_jointly(joint: JointSolve, board: Board, *, seed: int) -> StereoSolve:
    """Solve the images of a joint solve with mrcal; both lenses of the larger model.

    mrcal rejects outliers by rules of its own; images that the joint solve left out are not shown
    to it. Its covariance is enlarged by the factor of the joint solve.

    Raises
    ------
    MrcalMissingError, EstimationError
        If this machine has no mrcal, or it fails.
    """
    cameras, images = joint.cameras, joint.problem.images
    corners = [_by_view(joint, c) for c in (0, 1)]
    solution = solves.solve(
        corners,
        board,
        lens_model=solves.lens_model(cameras)[0],
        seed=seed,
        focal_px=[float(c.matrix[0, 0]) for c in cameras],
    )
    lenses = (
        camera_from_vector(solution.intrinsics[0], cameras[0].image_size),
        camera_from_vector(solution.intrinsics[1], cameras[1].image_size),
    )
    solve = from_mrcal(solution, "free", lenses)
    pairs = int(images.in_pair.sum())
    return StereoSolve(
        **{
            **vars(solve),
            "covariance": solve.covariance * joint.factors[2],
            "noise_covariance": solve.covariance * joint.factors[2],
            "dispersion": joint.factors[2],
            "residuals": solve.residuals[:, :pairs],
            "poses": solve.poses[:pairs],
        }
    )


def _by_view(joint: JointSolve, camera: int) -> Corners:
    """Return the corners of a camera by view of the board; NaN where it does not see one."""
    images = joint.problem.images
    pixels = np.full((images.views, *images.pixels.shape[1:]), np.nan)
    names = [str(v) for v in range(images.views)]
    kept = finite(joint.residuals).any(axis=-1) & (images.camera == camera)
    pixels[images.view[kept]] = images.pixels[kept]
    size = joint.cameras[camera].image_size
    return Corners(tuple(names), pixels, ("cache",) * images.views, size)
