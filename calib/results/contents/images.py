"""The image half of calibration.json: intrinsics, stereo, sweep."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from calib.core.arrays import FloatArray
from calib.document import cameras as document
from calib.document.fits import Estimate
from calib.document.part import matrix, vector
from calib.document.stereo import MeasuredParameters, PairTarget, StereoPart, StereoSolve, SweepPart
from calib.geometry.board import LensFit
from calib.geometry.camera import Camera
from calib.images.intrinsics.calibrate import Intrinsics
from calib.images.stereo.reference import StereoReference
from calib.images.sweep.yaw_axis import SweepResult

CameraName = Literal["c1", "c2"]


def intrinsics(
    cameras: Mapping[str, Camera],
    covariances: Mapping[str, FloatArray],
    found: Mapping[str, Intrinsics],
) -> dict[CameraName, document.Intrinsics] | None:
    """Return the intrinsics by camera; None where there are none.

    Parameters
    ----------
    cameras, covariances
        Given ones, and what is uncertain of their intrinsics, shape (4 + k, 4 + k).
    found
        Those from pictures.
    """
    names: tuple[CameraName, ...] = ("c1", "c2")
    of = {name: _given(cameras[name], covariances[name]) for name in names if name in cameras}
    of |= {name: _intrinsics(found[name]) for name in names if name in found}
    return of or None


def camera_matrix(camera: Camera) -> dict[str, Any]:
    """Return the keys of `CameraMatrix` of a camera."""
    return {
        "matrix": matrix(camera.matrix),
        "distortion": vector(camera.distortion),
        "image_size": camera.image_size,
        "projection": None if camera.projection == "perspective" else camera.projection,
    }


def _name(camera: Camera) -> str:
    """Return the name of a lens that is given."""
    if camera.projection != "perspective":
        return camera.projection
    count = len(camera.distortion)
    return f"OPENCV{count}" if count else "PINHOLE"


def _given(camera: Camera, covariance: FloatArray) -> document.Intrinsics:
    known = bool(covariance.any())
    return document.Intrinsics(
        source="given",
        lens_model=_name(camera),
        std=vector(np.sqrt(np.diag(covariance))) if known else None,
        covariance=matrix(covariance) if known else None,
        **camera_matrix(camera),
    )


def _lens(fit: LensFit) -> dict[str, Any]:
    """Return the keys of `Lens` of a solve."""
    return {
        "lens_model": fit.lens_model,
        "std": vector(np.sqrt(np.diag(fit.covariance))),
        "rms_px": fit.rms_px,
        "rejected_points": fit.rejected,
        "views": int(np.isfinite(fit.residuals).any(axis=(1, 2)).sum()),
        "board_warp_mm": None if fit.board_warp_mm is None else vector(fit.board_warp_mm),
    } | camera_matrix(fit.camera)


def _intrinsics(found: Intrinsics) -> document.Intrinsics:
    alternatives: dict[str, dict[str, document.Lens]] = {}
    for fit in (found.selected, *found.alternatives):
        alternatives.setdefault(fit.backend, {})[fit.lens_model] = document.Lens(**_lens(fit))
    own = found.alternatives[0] if found.purposes else found.selected
    kinds: tuple[Literal["lens", "pair", "row"], ...] = ("lens", "pair", "row")
    images = {kind: found.purposes[kind] for kind in kinds if kind in found.purposes}
    return document.Intrinsics(
        joint=document.JointLens(images=images) if images else None,
        covariance=matrix(found.covariance),
        dispersion=found.dispersion,
        selection=found.selection,
        rejected_views=tuple(found.rejected_views),
        alternatives=alternatives,
        **_lens(found.selected) | {"source": own.backend},
    )


def stereo(found: StereoReference) -> StereoPart:
    """Return the pose of C2."""
    placed = found.targets
    return StereoPart(
        source=found.source,
        transform_12=matrix(found.transform_12),
        covariance=matrix(found.covariance),
        baseline_mm=found.baseline_mm,
        baseline_std_mm=found.baseline_std_mm,
        rms_px=found.rms_px,
        pairs=len(found.stems),
        alternatives=tuple(
            StereoSolve(
                backend=solve.backend,
                intrinsics=solve.intrinsics,
                pose_12=vector(solve.pose_12),
                std=vector(np.sqrt(np.diag(solve.covariance))),
                rms_px=solve.rms_px,
            )
            for solve in found.solves
        ),
        targets=tuple(
            PairTarget(pair=stem, position_mm=vector(position), u_z_mm=float(u))
            for stem, position, u in zip(
                placed.stems, placed.triangulated.position_mm, placed.depth_std_mm, strict=True
            )
        ),
    )


def sweep(found: SweepResult) -> SweepPart:
    """Return the yaw axis."""
    return SweepPart(
        axis_direction_c2=vector(found.axis_direction_c2),
        axis_foot_c2_mm=vector(found.axis_foot_c2_mm),
        eccentricity_mm=Estimate(value=found.eccentricity_mm, std=found.eccentricity_std_mm),
        gaze_roll_rad=Estimate(value=found.gaze_roll_rad, std=found.gaze_roll_std_rad),
        encoder_scale=Estimate(value=found.encoder_scale, std=found.encoder_scale_std),
        measured=MeasuredParameters(
            names=tuple(found.names), mean=vector(found.mean), covariance=matrix(found.covariance)
        ),
        rms_px=found.rms_px,
        images=len(found.images),
    )
