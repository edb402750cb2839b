"""calibration.json: the adjustment of all pictures."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.core.arrays import BoolArray
from calib.document.adjustment import (
    AdjustedCamera,
    AdjustedReadings,
    AdjustedStereo,
    AdjustmentPart,
)
from calib.document.fits import Derived, Fit
from calib.document.part import matrix, vector
from calib.fit.robust import identified_by
from calib.fit.row_sums import residuals
from calib.geometry.camera import Camera
from calib.geometry.parameters import embed
from calib.geometry.poses import pose_matrix
from calib.images.adjustment.result import AdjustedModel, Adjustment
from calib.results.contents.diagnosis import gates
from calib.results.contents.fits import estimates, with_sources
from calib.results.contents.images import camera_matrix
from calib.results.effective_baseline import effective_baseline
from calib.results.headline import normal_interval
from calib.rows.observations import Observations

_BLOCKS = ("intrinsics_c1", "intrinsics_c2", "rig")


def fits(a: Adjustment, rows: Observations | None) -> dict[str, Fit]:
    """Return the fits, by NAME/adjustment.

    Parameters
    ----------
    rows
        Gaze rows, whose residuals are then stated; None where there are none to fit.
    """
    return {f"{model.model}/adjustment": _fit(a, model, rows) for model in a.models}


def _fit(a: Adjustment, model: AdjustedModel, rows: Observations | None) -> Fit:
    std = np.sqrt(np.diag(model.mount_covariance))
    return Fit(
        parameters=with_sources(
            estimates(model.names, model.values, model.covariance),
            [identified_by(float(share)) for share in model.data_share],
            model.data_share,
        ),
        names=tuple(model.names),
        covariance=matrix(model.covariance),
        derived=_derived(model),
        diagnostics={
            "misfit": model.misfit,
            "parameters_fewer": model.freedom,
            "factors": dict(zip(_BLOCKS, model.factors, strict=True)),
            "mount": {
                name: {"value": float(value), "std": float(s)}
                for name, value, s in zip(model.mount_names, model.mount, std, strict=True)
            },
            "board_warp_mm": tuple(model.board_warp_mm),
        },
        **_residuals(a, model, rows),
    )


def _derived(model: AdjustedModel) -> dict[str, Derived] | None:
    """Return L_b + e with the interval of a normal quantity."""
    found = effective_baseline(model.names, model.values, model.covariance)
    if found is None:
        return None
    low, high = normal_interval(*found)
    total = Derived(value=found[0], std=found[1], q2_5=low, q97_5=high)
    return {"effective_baseline_mm": total}


def _residuals(a: Adjustment, model: AdjustedModel, rows: Observations | None) -> dict[str, Any]:
    """Return the keys of `Fit` that are of rows; none without any."""
    if rows is None or not len(rows):
        return {}
    found = residuals(embed(model.values, model.names), rows).mrad
    out = _left_out(a, rows)
    return {
        "residual_mrad": vector(found),
        "sigma_mrad": float(np.sqrt(np.mean(found[~out] ** 2))) if (~out).any() else None,
        "outliers": tuple(rows.ids[i] for i in np.flatnonzero(out)),
    }


def _left_out(a: Adjustment, rows: Observations) -> BoolArray:
    """Return which rows have a picture that was left out whole, shape (n,)."""
    out = {row for row, image in a.row_images if image in a.left_out}
    return np.array([name in out for name in rows.ids], dtype=np.bool_)


def adjustment(a: Adjustment) -> AdjustmentPart:
    """Return what is not of one model: cameras, pose of C2, pictures, readings, gates."""
    record = a.complete
    shift = record.pose_12[3:]
    distance = float(np.linalg.norm(shift))
    along = shift / distance
    counts: dict[str, int] = {}
    for camera, kind in zip(a.camera, a.kinds, strict=True):
        name = f"c{camera + 1} {kind}"
        counts[name] = counts.get(name, 0) + 1
    c1, c2 = record.cameras
    return AdjustmentPart(
        model=record.model,
        passed=a.passed,
        intrinsics={"c1": _camera(record, "c1", c1), "c2": _camera(record, "c2", c2)},
        stereo=AdjustedStereo(
            alpha2_deg=float(np.degrees(record.reading_rad)),
            transform_12=matrix(pose_matrix(record.pose_12)),
            covariance=matrix(record.pose_covariance),
            baseline_mm=distance,
            baseline_std_mm=float(np.sqrt(along @ record.pose_covariance[3:, 3:] @ along)),
        ),
        pictures=counts,
        left_out=tuple(a.left_out),
        rejected_points=int(a.rejected.sum()),
        rms_px=a.rms_px,
        sigma_px=dict(a.sigma_px),
        readings=AdjustedReadings(
            count=len(a.readings_rad),
            stated_std_rad=a.stated_reading_rad,
            std_rad=a.reading_std_rad,
        ),
        gates=gates(a.gates),
    )


def _camera(model: AdjustedModel, name: str, camera: Camera) -> AdjustedCamera:
    own = [i for i, lens in enumerate(model.lens_names) if lens.startswith(f"{name}.")]
    covariance = model.lens_covariance[np.ix_(own, own)]
    return AdjustedCamera(
        std=vector(np.sqrt(np.diag(covariance))) if own else None,
        covariance=matrix(covariance) if own else None,
        **camera_matrix(camera),
    )
