"""calibration.json: the adjustment of all pictures."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.core.arrays import BoolArray
from calib.fit.robust import identified_by
from calib.fit.row_sums import residuals
from calib.geometry.camera import Camera
from calib.geometry.parameters import embed
from calib.geometry.poses import pose_matrix
from calib.images.adjustment.result import AdjustedModel, Adjustment
from calib.results.fits_document import derived, estimate
from calib.results.images_document import camera_document
from calib.rows.observations import Observations

_BLOCKS = ("intrinsics_c1", "intrinsics_c2", "rig")


def adjustment_fits(a: Adjustment, rows: Observations | None) -> dict[str, Any]:
    """Return the fits, by NAME/adjustment.

    Parameters
    ----------
    rows
        Gaze rows, whose residuals are then stated; None where there are none to fit.
    """
    return {f"{model.model}/adjustment": _fit(a, model, rows) for model in a.models}


def _fit(a: Adjustment, model: AdjustedModel, rows: Observations | None) -> dict[str, Any]:
    document = estimate(model.names, model.values, model.covariance)
    for name, share in zip(model.names, model.data_share, strict=True):
        document["parameters"][name] |= {
            "identified_by": identified_by(float(share)),
            "std_over_data_only_std": share,
        }
    document |= derived(model.names, model.values, model.covariance)
    if rows is not None and len(rows):
        found = residuals(embed(model.values, model.names), rows).mrad
        out = _left_out(a, rows)
        document |= {
            "residual_mrad": found,
            "sigma_mrad": float(np.sqrt(np.mean(found[~out] ** 2))) if (~out).any() else None,
            "outliers": [rows.ids[i] for i in np.flatnonzero(out)],
        }
    std = np.sqrt(np.diag(model.mount_covariance))
    document["diagnostics"] = {
        "misfit": model.misfit,
        "parameters_fewer": model.freedom,
        "factors": dict(zip(_BLOCKS, model.factors, strict=True)),
        "mount": {
            name: {"value": value, "std": s}
            for name, value, s in zip(model.mount_names, model.mount, std, strict=True)
        },
        "board_warp_mm": list(model.board_warp_mm),
    }
    return document


def _left_out(a: Adjustment, rows: Observations) -> BoolArray:
    """Return which rows have a picture that was left out whole, shape (n,)."""
    out = {row for row, image in a.row_images if image in a.left_out}
    return np.array([name in out for name in rows.ids], dtype=np.bool_)


def adjustment_section(a: Adjustment) -> dict[str, Any]:
    """Return what is not of one model: cameras, pose of C2, pictures, readings, gates."""
    record = a.complete
    shift = record.pose_12[3:]
    distance = float(np.linalg.norm(shift))
    along = shift / distance
    counts: dict[str, int] = {}
    for camera, kind in zip(a.camera, a.kinds, strict=True):
        name = f"c{camera + 1} {kind}"
        counts[name] = counts.get(name, 0) + 1
    return {
        "model": record.model,
        "passed": a.passed,
        "intrinsics": {
            f"c{c + 1}": _camera(record, f"c{c + 1}", camera)
            for c, camera in enumerate(record.cameras)
        },
        "stereo": {
            "alpha2_deg": float(np.degrees(record.reading_rad)),
            "transform_12": pose_matrix(record.pose_12),
            "covariance": record.pose_covariance,
            "baseline_mm": distance,
            "baseline_std_mm": float(np.sqrt(along @ record.pose_covariance[3:, 3:] @ along)),
        },
        "pictures": counts,
        "left_out": list(a.left_out),
        "rejected_points": int(a.rejected.sum()),
        "rms_px": a.rms_px,
        "sigma_px": dict(a.sigma_px),
        "readings": {
            "count": len(a.readings_rad),
            "stated_std_rad": a.stated_reading_rad,
            "std_rad": a.reading_std_rad,
        },
        "gates": [vars(gate) for gate in a.gates],
    }


def _camera(model: AdjustedModel, name: str, camera: Camera) -> dict[str, Any]:
    own = [i for i, lens in enumerate(model.lens_names) if lens.startswith(f"{name}.")]
    found = camera_document(camera)
    if own:
        covariance = model.lens_covariance[np.ix_(own, own)]
        found |= {"std": np.sqrt(np.diag(covariance)), "covariance": covariance}
    return found
