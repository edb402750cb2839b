"""Leave-views-out cross-validation of lens models, and the rule that selects one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board, Corners, LensFit
from calib.geometry.camera import intrinsic_vector, project_points
from calib.geometry.poses import transform
from calib.images.detection.grid import seen
from calib.images.intrinsics.solvers import solve_lens
from calib.images.pairs import single_view_pose

FOLDS = 5
"""Views are left out a fifth at a time: every solve keeps four fifths of the poses, and five solves
take 0.1 s."""

GAIN_SIGMAS = 2.0
"""A lens model with more parameters must predict left-out views better by this many standard errors
of the mean gain, paired view by view: without need it is taken in 2 % of cases."""

GAIN_MIN = 0.01
"""And it must bring their rms down by this share at least: views share a fold and so an error of
the lens, which makes the standard error a little too small, and a gain of less changes no result.
Lenses that need the larger model gain 20 % and more."""


@dataclass(frozen=True)
class CrossValidation:
    """How well lens models predict views that they have not seen.

    Parameters
    ----------
    images
        Of the views.
    lenses
        Names of the lens models, simplest first.
    view_rms_px
        Root mean square per coordinate of each view's residuals when it was left out and only its
        pose fitted, px, shape (lenses, views); NaN for views not used.
    rms_px
        Over all views, shape (lenses,).
    fitted_rms_px
        The same when no view was left out, shape (lenses,).
    ratio
        Median over views of the rms when left out over that when fitted, shape (lenses,): unlike
        the rms it does not hang on one view at the edge of what the others cover.
    std_jackknife
        Standard deviation of fx, fy, cx, cy of the chosen lens by the delete-a-group jackknife, px,
        shape (4,): what the views say of it without a model of the noise.
    chosen
        The lens model that the rule selects.
    reason
        The figures that decided.
    """

    images: tuple[str, ...]
    lenses: tuple[str, ...]
    view_rms_px: FloatArray
    rms_px: FloatArray
    fitted_rms_px: FloatArray
    ratio: FloatArray
    std_jackknife: FloatArray
    chosen: str
    reason: str


def cross_validate(
    corners: Corners,
    board: Board,
    fits: Mapping[str, LensFit],
    *,
    points: Mapping[str, FloatArray],
) -> CrossValidation:
    """Cross-validate the lens models of fits, in `FOLDS` folds of views.

    View i of those used belongs to fold i modulo `FOLDS`. One solver serves for all backends of a
    lens model (`calib.images.intrinsics.solvers`): what is tested is lens model and pictures, which
    they share, and not the solver. Lens models are compared on the corners that any of them uses: a
    model that fits what it keeps and rejects the rim of the picture predicts no better.

    Parameters
    ----------
    fits
        By lens model, simplest first; the corners they rejected stay out.
    points
        Corners in the board's frame, mm, shape (corners, 3), by lens model.

    Raises
    ------
    EstimationError
        If no lens model can be solved in all folds.
    """
    view_rms, all_rms, parameters = {}, {}, {}
    failed: dict[str, str] = {}
    judged = np.any([seen(fit.residuals) for fit in fits.values()], axis=0)
    for lens, fit in fits.items():
        try:
            found = _leave_out(corners, board, fit, lens, points[lens], judged=judged)
            view_rms[lens], all_rms[lens], parameters[lens] = found
        except EstimationError as error:
            failed[lens] = str(error)
    if not view_rms:
        raise EstimationError("cross-validation: " + "; ".join(failed.values()))
    weight = np.stack([np.isfinite(fits[lens].residuals).sum(axis=(1, 2)) for lens in view_rms])
    squares = np.stack([view_rms[lens] ** 2 for lens in view_rms])
    lenses = tuple(view_rms)
    fitted = np.stack([_rms_of_views(fits[lens].residuals) for lens in lenses])
    chosen, reason = select_lens(lenses, np.stack([all_rms[lens] ** 2 for lens in lenses]))
    folds = parameters[chosen][:, :4]
    spread = folds - folds.mean(axis=0)
    return CrossValidation(
        images=corners.images,
        lenses=lenses,
        view_rms_px=np.sqrt(squares),
        rms_px=np.sqrt(np.nansum(squares * weight, axis=1) / weight.sum(axis=1)),
        fitted_rms_px=np.array([fits[lens].rms_px for lens in lenses]),
        ratio=np.nanmedian(np.sqrt(squares) / fitted, axis=1),
        std_jackknife=np.sqrt((len(folds) - 1) / len(folds) * (spread**2).sum(axis=0)),
        chosen=chosen,
        reason="; ".join([reason, *(f"{name} failed: {why}" for name, why in failed.items())]),
    )


def _leave_out(
    corners: Corners,
    board: Board,
    fit: LensFit,
    lens: str,
    points: FloatArray,
    *,
    judged: BoolArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what left-out views and the folds say.

    Each view's rms, px, (views,), over the corners that the fit uses and over those `judged`,
    (views, corners), by the pose that its own corners give; the folds' intrinsics, (folds, p).
    """
    used = seen(fit.residuals)
    views = np.flatnonzero(used.any(axis=-1))
    rms, over_all = np.full((2, len(used)), np.nan)
    parameters = []
    for fold in range(min(FOLDS, len(views))):
        left_out = views[fold::FOLDS]
        kept = used.copy()
        kept[left_out] = False
        camera = solve_lens(corners, board, kept, lens=lens, points=points, start=fit.camera)
        parameters.append(intrinsic_vector(camera))
        for i in left_out:
            pixels = np.where(used[i, :, None], corners.pixels[i], np.nan)
            pose, rms[i] = single_view_pose(camera, points=points, pixels=pixels)
            over_all[i] = rms[i]
            if not np.array_equal(judged[i], used[i]):
                seen_there = project_points(camera, transform(pose, points[judged[i]])).pixels
                off = corners.pixels[i, judged[i]] - seen_there
                over_all[i] = np.sqrt(np.mean(off**2))
    return rms, over_all, np.stack(parameters)


def _rms_of_views(residuals: FloatArray) -> FloatArray:
    """Return the rms per coordinate of each view, px, shape (views,); NaN where there is none."""
    known = np.isfinite(residuals)
    squares = np.where(known, residuals, 0.0) ** 2
    with np.errstate(invalid="ignore"):
        rms: FloatArray = np.sqrt(squares.sum(axis=(1, 2)) / known.sum(axis=(1, 2)))
    return rms


def select_lens(lenses: tuple[str, ...], squares: FloatArray) -> tuple[str, str]:
    """Return the lens model to use and the figures that decide.

    The simplest one, unless a later one predicts left-out views better by more than `GAIN_SIGMAS`
    standard errors and `GAIN_MIN`. The gain is the mean over views of the logarithm of the ratio of
    their rms: of the rms itself, one view at the edge of what the others cover would decide all.

    Parameters
    ----------
    lenses
        Names, simplest first.
    squares
        Mean squared residual of each left-out view, px^2, shape (lenses, views); NaN if not used.
    """
    best = 0
    reasons = []
    for other in range(1, len(lenses)):
        both = np.isfinite(squares[[best, other]]).all(axis=0)
        gain = np.log(squares[best, both] / squares[other, both]) / 2
        error = float(gain.std(ddof=1) / np.sqrt(len(gain)))
        better = float(gain.mean()) > max(GAIN_SIGMAS * error, GAIN_MIN)
        low, middle, high = np.exp(-gain.mean() + GAIN_SIGMAS * error * np.array([-1, 0, 1]))
        reasons.append(
            f"{lenses[other]} predicts left-out views with {middle:.3f} times the rms of "
            f"{lenses[best]} ({low:.3f} to {high:.3f} at {GAIN_SIGMAS:g} standard errors): "
            f"{lenses[other if better else best]} it is"
        )
        best = other if better else best
    return lenses[best], "; ".join(reasons) or f"{lenses[0]} is the only lens model solved"
