"""The intrinsics of a camera after the joint solve: all its images of the board count."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import Corners, LensFit
from calib.images.detection.grid import seen
from calib.images.intrinsics.calibrate import Intrinsics
from calib.images.intrinsics.gates import intrinsics_gates, views_left_out
from calib.images.intrinsics.maps import compare, map_uncertainty, measure_coverage, nodes, rays_of
from calib.images.joint.lens import RefinedLens

_PURPOSES = {"lens": "for the lens", "pair": "of pairs", "row": "of gaze rows"}


def refine(found: Intrinsics, lens: RefinedLens, corners: Corners) -> Intrinsics:
    """Return the intrinsics with the estimate of the joint solve in place of the camera's own.

    Lens model, cross-validation and backends side by side stay as the camera's own pictures gave
    them; the estimate so far becomes the first alternative.

    Parameters
    ----------
    corners
        Of all images of the camera.
    """
    pixels = corners.select(lens.images).pixels
    fit = LensFit(
        backend="joint",
        lens_model=found.selected.lens_model,
        camera=lens.camera,
        covariance=lens.covariance,
        rms_px=float(np.sqrt(np.nanmean(lens.residuals**2))),
        residuals=_as_found(lens, pixels),
        poses=lens.poses,
        rejected=int((seen(lens.pixels) & ~seen(lens.residuals)).sum()),
        board_warp_mm=lens.board_warp_mm,
    )
    inliers = np.where(np.isfinite(fit.residuals), pixels, np.nan)
    at = nodes(inliers, corners.image_size)
    uncertainty = map_uncertainty(fit, at)
    coverage = measure_coverage(inliers, corners.image_size)
    lost = seen(pixels).any(axis=-1) & ~seen(fit.residuals).any(axis=-1)
    dropped = tuple(lens.images[i] for i in np.flatnonzero(lost))
    gates = intrinsics_gates(
        found.name,
        fit,
        coverage,
        found.validation,
        agreement=None,
        left_out=views_left_out(lens.images, pixels, fit.residuals),
        uncertainty=uncertainty,
    )
    before, kept = found.selected, (f"{found.name}-backends", f"{found.name}-way-up")
    return replace(
        found,
        selected=fit,
        covariance=lens.covariance,
        dispersion=lens.dispersion,
        alternatives=(before, *found.alternatives),
        selection=f"{found.selection}; refined by the joint solve of lenses and pairs, with "
        f"{_purposes(lens)}",
        images=lens.images,
        rejected_views=(*found.rejected_views, *dropped),
        coverage=coverage,
        uncertainty=uncertainty,
        differences=(*found.differences, compare(fit, rays_of(before, at), at)),
        gates=(*gates, *(g for g in found.gates if g.name in kept)),
        purposes=dict(Counter(lens.kinds)),
    )


def _as_found(lens: RefinedLens, pixels: FloatArray) -> FloatArray:
    """Return residuals in the order in which the corners were found; a pair may be turned."""
    residuals = lens.residuals.copy()
    for i, (own, first) in enumerate(zip(lens.pixels, pixels, strict=True)):
        if not np.array_equal(own, first, equal_nan=True):
            residuals[i] = residuals[i, ::-1]
    return residuals


def _purposes(lens: RefinedLens) -> str:
    counts = Counter(lens.kinds)
    told = [f"{counts[kind]} {words}" for kind, words in _PURPOSES.items() if counts[kind]]
    return f"{len(lens.images)} images ({', '.join(told)})"
