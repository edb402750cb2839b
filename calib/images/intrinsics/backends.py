"""Intrinsics of one camera by every backend and lens model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board, Corners, LensFit
from calib.geometry.camera import Camera, normalise
from calib.images.bundle import deformed
from calib.images.detection.grid import seen
from calib.images.intrinsics.by_mrcal import MrcalFits, fit_mrcal
from calib.images.intrinsics.by_opencv import fit_opencv
from calib.images.intrinsics.by_views import equidistant_start, fit_views
from calib.images.intrinsics.lenses import LENSES, PERSPECTIVE, WIDE
from calib.images.intrinsics.maps import GRID
from calib.images.mrcal.solves import field_of

WIDE_DEG = 45.0
"""Angle off the axis of the outermost corner, under any lens model, from which on a lens counts as
wide: at 41 degrees Brown's five coefficients fit an equidistant lens to its noise of 0.1 px, at 52
they leave 0.12 px."""

WIDE_REJECTED = 0.02
"""Share of corners that a perspective lens rejects in views it uses, from which on the lens may
be a wide one: at 75 degrees a rational lens loses 9 %, those at the rim, and fits the rest to their
noise. Whole views left out are of another kind: blurred, or of something else."""

BETTER_START = 1.05
"""A fit whose rms is larger than another backend's by this factor, with the same lens and board,
has not found the minimum, and starts once more from there."""


@dataclass(frozen=True)
class Backends:
    """Fits by lens model.

    Parameters
    ----------
    flat
        OpenCV's, to the board as drawn.
    bowed
        Those that solve the board deformation too: mrcal's, and of a wide lens this program's own.
    checked
        OpenCV's, to `points`.
    points
        The board as `bowed` has it, as drawn without, mm, shape (corners, 3).
    mrcal
        What mrcal made of the corners.
    failed
        Which lens models the views do not determine, or OpenCV does not solve.
    """

    flat: Mapping[str, LensFit]
    bowed: Mapping[str, LensFit]
    checked: Mapping[str, LensFit]
    points: Mapping[str, FloatArray]
    mrcal: MrcalFits
    failed: tuple[str, ...]

    @property
    def all(self) -> tuple[LensFit, ...]:
        """The fits that are reported."""
        return (*self.flat.values(), *self.bowed.values())

    @property
    def tested(self) -> Mapping[str, LensFit]:
        """The fits whose lens models are cross-validated, that of fewest coefficients first.

        Of an equidistant lens it is this program's own.
        """
        fits = dict(self.checked) | ({WIDE: self.bowed[WIDE]} if WIDE in self.bowed else {})
        return {lens: fits[lens] for lens in LENSES if lens in fits}


def solve_backends(corners: Corners, board: Board, seed: int) -> Backends:
    """Solve with OpenCV, then with mrcal without the views that OpenCV found wrong with any lens.

    A view that mrcal discards corner by corner, to the last, leaves its pose open and the solve
    without a covariance. The equidistant lens is solved where the perspective ones show a wide one.

    Raises
    ------
    EstimationError
        If no lens model is solved at all.
    """
    drawn = board.object_points()
    points = dict.fromkeys([*PERSPECTIVE, WIDE], drawn)
    flat, failed = _by_opencv(corners, board, {}, points, tuple(PERSPECTIVE))
    own, why = _own(corners, drawn) if is_wide(flat, corners) else (None, ())
    if own is None and next(iter(PERSPECTIVE)) not in flat:
        raise EstimationError("; ".join((*failed, *why)))
    fits = [*flat.values(), *([own] if own else [])]
    used = np.any([views_of(fit) for fit in fits], axis=0)
    unused = seen(corners.pixels) & ~used[:, None]
    kept = replace(corners, pixels=np.where(unused[..., None], np.nan, corners.pixels))
    mrcal = fit_mrcal(
        kept,
        board,
        lenses=PERSPECTIVE,
        seed=seed,
        grid=GRID,
        others=flat,
        field_deg=None if own is None else field_of(own.camera),
    )
    mrcal = replace(
        mrcal,
        fits={
            lens: replace(fit, rejected=fit.rejected + int(unused.sum()))
            for lens, fit in mrcal.fits.items()
        },
    )
    bowed = dict(mrcal.fits) | ({WIDE: own} if own else {})
    points |= {lens: deformed(drawn, fit.board_warp_mm) for lens, fit in bowed.items()}
    checked = flat
    if mrcal.fits:
        start = {lens: fit.camera for lens, fit in flat.items()}
        checked, failed = _by_opencv(corners, board, start, points, tuple(PERSPECTIVE))
        checked |= from_better(corners, board, checked, mrcal.fits, points)
    if own is not None:
        wide, unsolved = _by_opencv(corners, board, {}, points | {WIDE: drawn}, (WIDE,))
        flat |= wide
        start = {lens: fit.camera for lens, fit in wide.items()}
        again, _ = _by_opencv(corners, board, start, points, tuple(wide))
        checked, failed = checked | again, (*failed, *unsolved)
    return Backends(flat, bowed, checked, points, mrcal, (*failed, *why))


def views_of(fit: LensFit) -> BoolArray:
    """Return which views a fit uses, shape (views,)."""
    return np.asarray(np.isfinite(fit.residuals).any(axis=(1, 2)))


def is_wide(flat: Mapping[str, LensFit], corners: Corners) -> bool:
    """Return whether fits of perspective lenses show that the lens may be a wide one.

    A lens of many coefficients that views leave open is none: narrow lenses leave them open.
    """
    if next(iter(PERSPECTIVE)) not in flat:
        return True
    return any(
        _rejected_share(fit, corners) > WIDE_REJECTED or _reach_deg(fit, corners) > WIDE_DEG
        for fit in flat.values()
    )


def _rejected_share(fit: LensFit, corners: Corners) -> float:
    """Return the share of corners that a fit rejects in the views that it uses."""
    used = seen(fit.residuals)
    found = int(seen(corners.pixels[used.any(axis=-1)]).sum())
    return 1 - int(used.sum()) / found


def _reach_deg(fit: LensFit, corners: Corners) -> float:
    """Return how far off the axis the outermost corner lies that a fit uses, deg."""
    pixels = corners.pixels[np.isfinite(fit.residuals).all(axis=-1)]
    xy = normalise(fit.camera, pixels, strict=False)
    return float(np.degrees(np.arctan(np.nanmax(np.hypot(*xy.T), initial=0.0))))


def _own(corners: Corners, points: FloatArray) -> tuple[LensFit | None, tuple[str, ...]]:
    """Return this program's fit of an equidistant lens, or why there is none."""
    try:
        start = equidistant_start(corners, points)
        return fit_views(corners, points, start=start, lens=WIDE, warp=True), ()
    except EstimationError as error:
        return None, (f"{WIDE}: {error}",)


def _by_opencv(
    corners: Corners,
    board: Board,
    start: Mapping[str, Camera],
    points: Mapping[str, FloatArray],
    lenses: tuple[str, ...],
) -> tuple[dict[str, LensFit], tuple[str, ...]]:
    """Return OpenCV's fits by lens model, and why others failed."""
    fits, failed = {}, []
    for lens in lenses:
        begin = start.get(lens)
        try:
            fits[lens] = fit_opencv(corners, board, lens=lens, points=points[lens], start=begin)
        except EstimationError as error:
            failed.append(f"{lens}: {error}")
    return fits, tuple(failed)


def from_better(
    corners: Corners,
    board: Board,
    checked: Mapping[str, LensFit],
    others: Mapping[str, LensFit],
    points: Mapping[str, FloatArray],
) -> dict[str, LensFit]:
    """Return OpenCV's fits that are better once they start from another backend's minimum."""
    lacking = {
        lens: fit.camera
        for lens, fit in others.items()
        if lens not in checked or checked[lens].rms_px > BETTER_START * fit.rms_px
    }
    again, _ = _by_opencv(corners, board, lacking, points, tuple(lacking))
    return {
        lens: fit
        for lens, fit in again.items()
        if lens not in checked or fit.rms_px < checked[lens].rms_px
    }
