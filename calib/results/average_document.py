"""calibration.json: the average over the fitted models."""

from __future__ import annotations

from typing import Any

from calib.core.arrays import FloatArray
from calib.instrument.averaging import ModelAverage
from calib.uncertainty.measurement import SharedErrors


def average_document(average: ModelAverage) -> dict[str, Any]:
    """Return what `calib measure --model` needs of each model, for the section `measurement`."""
    return {
        "average": [
            {
                "model": share.model,
                "weight": share.weight,
                "names": list(share.instrument.parameters.names),
                "values": share.instrument.parameters.values,
                "covariance": share.instrument.parameters.covariance,
                "noise_factor": share.noise_factor,
                "factor95": share.factor95,
                "with_parameters": _with_parameters(share.instrument.shared),
            }
            for share in average.shares
        ]
    }


def _with_parameters(shared: SharedErrors | None) -> FloatArray | None:
    """Return what the errors that readings have too have moved the parameters by; None if none."""
    if shared is None or not shared.of_readings:
        return None
    return shared.with_parameters[:, : shared.of_readings]


def average_depths(average: ModelAverage) -> list[dict[str, Any]]:
    """Return the depths of `depth_uncertainty` as all models together measure them."""
    p = average.prediction
    return [
        {
            "z_mm": average.depth_mm[i],
            "mean_mm": p.z_mm[i],
            "u_mm": p.u_mm[i],
            "low95_mm": p.low95_mm[i],
            "high95_mm": p.high95_mm[i],
        }
        for i in range(len(average.depth_mm))
    ]
