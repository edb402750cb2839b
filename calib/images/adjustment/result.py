"""Stage: the adjustment, for each model and for all parameters together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.core.gate import Gate
from calib.core.unit_diagonal import unit_diagonal
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera, intrinsic_names
from calib.geometry.parameters import MODELS, NAMES, STANDOFF
from calib.images.adjustment.gates import adjustment_gates, left_out
from calib.images.adjustment.gather import Taken, gather
from calib.images.adjustment.mounting import HEIGHT, PITCH, RIG, pose_by_rig
from calib.images.adjustment.solve import AdjustmentSolution, hold, solve
from calib.images.bundle import inverse
from calib.images.stereo.solve import CameraPair

COMPLETE = "complete"
"""The model in which every parameter of the rig is free."""

CONTRADICTED = 1e-3
"""Probability below which the pictures contradict a model that holds parameters at 0."""


@dataclass(frozen=True)
class AdjustedModel:
    """One model by all pictures.

    Parameters
    ----------
    model
        A name of `MODELS`, or `COMPLETE`.
    names
        Its free parameters, p of them, in the order of `PARAMETERS`.
    values, covariance
        Shapes (p,), (p, p).
    mount_names, mount
        C2's height and pitch on its axis, mm and rad: they move the gaze plane nowhere; (2,).
    mount_covariance
        Shape (2, 2).
    data_share
        Standard deviation over that without priors, shape (p,).
    cameras
        C1 and C2.
    lens_names, lens_covariance
        Names ("c1.fx") and covariance of the intrinsics, q of them; 0 where given.
    with_lens
        Covariance of `values` with the intrinsics, shape (p, q).
    pose_12, pose_covariance
        Pose of C2 in C1 at `reading_rad`, rad and mm, shapes (6,), (6, 6).
    with_pose
        Covariance of `values` with the pose at which C2 truly stood for the pairs, shape (p, 6).
    reading_rad
        At which C2 was held for the pairs; 90 deg without.
    board_warp_mm
        Board deformation along x and y, mm.
    factors
        On the variances of the intrinsics of C1, of C2 and of the rig: see `solve.Solution`.
    misfit, freedom
        Sum of squares beyond that of `COMPLETE`, in variances as the views show them, and how many
        parameters fewer are free.
    """

    model: str
    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    mount_names: tuple[str, ...]
    mount: FloatArray
    mount_covariance: FloatArray
    data_share: FloatArray
    cameras: tuple[Camera, Camera]
    lens_names: tuple[str, ...]
    lens_covariance: FloatArray
    with_lens: FloatArray
    pose_12: FloatArray
    pose_covariance: FloatArray
    with_pose: FloatArray
    reading_rad: float
    board_warp_mm: tuple[float, float]
    factors: tuple[float, float, float]
    misfit: float
    freedom: int


@dataclass(frozen=True)
class Adjustment:
    """All pictures in one least squares.

    Parameters
    ----------
    models
        The models that the pictures do not contradict, `COMPLETE` last.
    contradicted
        Of the other models, what says so.
    images, kinds, camera
        The i pictures, what each was taken for ("lens", "pair", "row", "sweep"), and whose (0 for
        C1, 1 for C2).
    residuals
        Of `COMPLETE`: observed minus projected, px, shape (i, corners, 2); NaN where missing or
        rejected.
    rejected
        Corners found and left out, shape (i, corners), those of pictures left out whole too.
    left_out
        Pictures left out whole: they contradict the others.
    row_images
        Gaze rows and the pictures that they name.
    sigma_px
        Standard deviation of a corner coordinate by camera and kind of picture.
    readings_rad, reading_errors_rad
        Readings of the encoder, and how much farther C2 truly stood, shape (e,).
    stated_reading_rad, reading_std_rad
        Standard deviation of the errors of readings as stated and as the pictures show it.
    gates
        What must hold before it is used.
    """

    models: tuple[AdjustedModel, ...]
    contradicted: dict[str, str]
    images: tuple[str, ...]
    kinds: tuple[str, ...]
    camera: tuple[int, ...]
    residuals: FloatArray
    rejected: BoolArray
    left_out: tuple[str, ...]
    row_images: tuple[tuple[str, str], ...]
    sigma_px: dict[str, float]
    readings_rad: FloatArray
    reading_errors_rad: FloatArray
    stated_reading_rad: float
    reading_std_rad: float
    gates: tuple[Gate, ...]

    @property
    def complete(self) -> AdjustedModel:
        """The model with all parameters free: of record."""
        return self.models[-1]

    @property
    def passed(self) -> bool:
        """Whether it may be used."""
        return all(gate.passed for gate in self.gates)

    @property
    def rms_px(self) -> float:
        """Root mean square of the residuals, px per coordinate."""
        return float(np.sqrt(np.nanmean(self.residuals**2)))


def adjust(
    corners_c1: Corners, corners_c2: Corners, taken: Taken, board: Board, rig: CameraPair
) -> Adjustment:
    """Adjust all pictures.

    Parameters
    ----------
    rig
        Cameras to start from; those that are not `free` move within their covariance.

    Raises
    ------
    EstimationError
        If the pictures do not tell the rig, with the reason; if no minimum is reached.
    """
    problem, start = gather(taken, (corners_c1, corners_c2), board, rig)
    found = solve(problem, start)
    reading = np.pi / 2 if taken.held_rad is None else taken.held_rad
    complete = _described(COMPLETE, found, found, reading)
    contradicted = {name: _contradiction(found, _free(name)) for name in MODELS}
    models = tuple(
        _described(name, hold(found, _free(name)), found, reading)
        for name, words in contradicted.items()
        if not words
    )
    pictures = found.problem.pictures
    return Adjustment(
        models=(*models, complete),
        contradicted={name: words for name, words in contradicted.items() if words},
        images=pictures.names,
        kinds=pictures.kinds,
        camera=tuple(int(c) for c in pictures.camera),
        residuals=found.residuals,
        rejected=found.rejected,
        left_out=tuple(pictures.names[i] for i in left_out(found)),
        row_images=_row_images(taken),
        sigma_px=found.sigma_px,
        readings_rad=pictures.readings_rad,
        reading_errors_rad=found.reading_errors_rad,
        stated_reading_rad=taken.reading_std_rad,
        reading_std_rad=found.problem.reading_std_rad,
        gates=adjustment_gates(found, taken.reading_std_rad),
    )


def _row_images(taken: Taken) -> tuple[tuple[str, str], ...]:
    rows = taken.rows
    named = zip(rows.ids, zip(rows.image_c1, rows.image_c2, strict=True), strict=True)
    return tuple((row, image) for row, both in named for image in both if image is not None)


def _free(model: str) -> tuple[str, ...]:
    """Return the free unknowns of the rig in a model: pictures show standoff, height and pitch."""
    wanted = {*MODELS[model].free, STANDOFF, HEIGHT, PITCH}
    return tuple(name for name in RIG if name in wanted)


def _contradiction(found: AdjustmentSolution, names: tuple[str, ...]) -> str:
    """Return what the pictures say against holding all but some unknowns at 0; "" if nothing.

    Wald's test of the estimates, with priors.
    """
    problem = found.problem
    dropped = [k for k, name in enumerate(problem.names) if name not in names]
    at = problem.at_rig[dropped]
    values, spread = found.reduced.at.shared[at], found.covariance[np.ix_(at, at)]
    std, correlation = unit_diagonal(spread)
    statistic = float(values / std @ np.linalg.solve(correlation, values / std))
    if chi2.sf(statistic, len(at)) >= CONTRADICTED:
        return ""
    worst = int(np.argmax(np.abs(values / std)))
    return (
        f"the pictures contradict it: {problem.names[dropped[worst]]} is {values[worst]:.4g} with "
        f"a standard uncertainty of {std[worst]:.2g} (chi2 {statistic:.0f} of {len(at)})"
    )


def _described(
    model: str, s: AdjustmentSolution, complete: AdjustmentSolution, reading: float
) -> AdjustedModel:
    problem, spread = s.problem, s.covariance
    names = tuple(name for name in NAMES if name in problem.names)
    at = problem.at_rig[[problem.names.index(name) for name in names]]
    mount = tuple(name for name in problem.names if name not in NAMES)
    at_mount = problem.at_rig[[problem.names.index(name) for name in mount]]
    x = s.reduced.at.shared
    lens_names, at_lens = [], []
    for c, camera in enumerate(s.cameras):
        own = problem.at_lens(c)
        if len(own):
            lens_names += [f"c{c + 1}.{name}" for name in intrinsic_names(camera)]
            at_lens += list(own)
    pose, by_rig = pose_by_rig(s.rig, reading)
    by = by_rig[:, [RIG.index(name) for name in problem.names]]
    inside = np.ix_(problem.at_rig, problem.at_rig)
    freedom = len(RIG) - len(problem.names)
    misfit = (s.reduced.cost - complete.reduced.cost) / max(1.0, complete.factors[2])
    return AdjustedModel(
        model=model,
        names=names,
        values=x[at],
        covariance=spread[np.ix_(at, at)],
        mount_names=mount,
        mount=x[at_mount],
        mount_covariance=spread[np.ix_(at_mount, at_mount)],
        data_share=_data_share(s)[[problem.names.index(name) for name in names]],
        cameras=s.cameras,
        lens_names=tuple(lens_names),
        lens_covariance=spread[np.ix_(at_lens, at_lens)],
        with_lens=spread[np.ix_(at, at_lens)],
        pose_12=pose,
        pose_covariance=by @ spread[inside] @ by.T,
        with_pose=spread[np.ix_(at, problem.at_rig)] @ by.T + _with_held(s, at, by_rig),
        reading_rad=reading,
        board_warp_mm=s.board_warp_mm,
        factors=s.factors,
        misfit=float(misfit),
        freedom=freedom,
    )


def _with_held(s: AdjustmentSolution, at: IntArray, by_rig: FloatArray) -> FloatArray:
    """Return what the error of the pairs' reading adds to `AdjustedModel.with_pose`, (p, 6)."""
    problem, pictures = s.problem, s.problem.pictures
    paired = [k for k, kind in enumerate(pictures.kinds) if kind == "pair"]
    held = np.flatnonzero(np.isin(pictures.shared, pictures.exposure[paired]))
    by_turn = by_rig[:, RIG.index("delta2_rad")] * problem.reading_std_rad
    shared = s.covariance[np.ix_(at, problem.at_held[held])].sum(axis=1)
    added: FloatArray = np.outer(shared, by_turn)
    return added


NEARLY_NO_PRIOR = 1e-8
"""Share of the priors' precision left when asking what the pictures alone determine."""


def _data_share(s: AdjustmentSolution) -> FloatArray:
    """Return standard deviations of the rig over those without priors, one a free unknown."""
    matrix = s.reduced.normals.sum(axis=0)
    known = s.reduced.normals[-1].copy()
    held = s.problem.at_held
    known[held, held] = 0.0
    alone = inverse(matrix - (1 - NEARLY_NO_PRIOR) * known)
    share: FloatArray = np.sqrt(np.diag(s.reduced.spread()) / np.diag(alone))[s.problem.at_rig]
    return share
