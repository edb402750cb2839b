"""The image half of calibration.json: intrinsics, stereo, sweep."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import LensFit
from calib.geometry.camera import Camera
from calib.images.intrinsics.calibrate import Intrinsics
from calib.images.result import ImageResult
from calib.images.stereo.reference import StereoReference
from calib.images.sweep.yaw_axis import SweepResult


def images_document(
    cameras: Mapping[str, Camera], covariances: Mapping[str, FloatArray], images: ImageResult
) -> dict[str, Any]:
    """Return the parts that the images gave, and given cameras; absent where there are none.

    Parameters
    ----------
    cameras, covariances
        Given ones, and what is uncertain of their intrinsics, shape (4 + k, 4 + k).
    """
    document: dict[str, Any] = {}
    intrinsics = {name: _given(camera, covariances[name]) for name, camera in cameras.items()}
    intrinsics |= {name: _intrinsics(found) for name, found in images.intrinsics.items()}
    if intrinsics:
        document["intrinsics"] = intrinsics
    if images.stereo is not None:
        document["stereo"] = _stereo(images.stereo)
    if images.sweep is not None:
        document["sweep"] = _sweep(images.sweep)
    return document


def _given(camera: Camera, covariance: FloatArray) -> dict[str, Any]:
    count = len(camera.distortion)
    lens = f"OPENCV{count}" if count else "PINHOLE"
    document = {"source": "given", "lens_model": lens} | camera_document(camera)
    if covariance.any():
        document |= {"std": np.sqrt(np.diag(covariance)), "covariance": covariance}
    return document


def camera_document(camera: Camera) -> dict[str, Any]:
    """Return matrix, lens and size of a camera."""
    return {
        "matrix": camera.matrix,
        "distortion": camera.distortion,
        "image_size": list(camera.image_size),
    }


def _lens(fit: LensFit) -> dict[str, Any]:
    std = np.sqrt(np.diag(fit.covariance))
    found = {"lens_model": fit.lens_model} | camera_document(fit.camera)
    found |= {"std": std, "rms_px": fit.rms_px, "rejected_points": fit.rejected}
    found["views"] = int(np.isfinite(fit.residuals).any(axis=(1, 2)).sum())
    if fit.board_warp_mm is not None:
        found["board_warp_mm"] = list(fit.board_warp_mm)
    return found


def _intrinsics(found: Intrinsics) -> dict[str, Any]:
    alternatives: dict[str, dict[str, Any]] = {}
    for fit in (found.selected, *found.alternatives):
        alternatives.setdefault(fit.backend, {})[fit.lens_model] = _lens(fit)
    own = found.alternatives[0] if found.purposes else found.selected
    refined = {"joint": {"images": dict(found.purposes)}} if found.purposes else {}
    return (
        {"source": own.backend}
        | _lens(found.selected)
        | refined
        | {
            "covariance": found.covariance,
            "dispersion": found.dispersion,
            "selection": found.selection,
            "rejected_views": list(found.rejected_views),
            "alternatives": alternatives,
        }
    )


def _stereo(found: StereoReference) -> dict[str, Any]:
    return {
        "source": found.source,
        "transform_12": found.transform_12,
        "covariance": found.covariance,
        "baseline_mm": found.baseline_mm,
        "baseline_std_mm": found.baseline_std_mm,
        "rms_px": found.rms_px,
        "pairs": len(found.stems),
        "alternatives": [
            {
                "backend": solve.backend,
                "intrinsics": solve.intrinsics,
                "pose_12": solve.pose_12,
                "std": np.sqrt(np.diag(solve.covariance)),
                "rms_px": solve.rms_px,
            }
            for solve in found.solves
        ],
        "targets": [
            {"pair": stem, "position_mm": position, "u_z_mm": u}
            for stem, position, u in zip(
                found.targets.stems,
                found.targets.triangulated.position_mm,
                found.targets.depth_std_mm,
                strict=True,
            )
        ],
    }


def _sweep(found: SweepResult) -> dict[str, Any]:
    return {
        "axis_direction_c2": found.axis_direction_c2,
        "axis_foot_c2_mm": found.axis_foot_c2_mm,
        "eccentricity_mm": {"value": found.eccentricity_mm, "std": found.eccentricity_std_mm},
        "gaze_roll_rad": {"value": found.gaze_roll_rad, "std": found.gaze_roll_std_rad},
        "encoder_scale": {"value": found.encoder_scale, "std": found.encoder_scale_std},
        "measured": {
            "names": list(found.names),
            "mean": found.mean,
            "covariance": found.covariance,
        },
        "rms_px": found.rms_px,
        "images": len(found.images),
    }
