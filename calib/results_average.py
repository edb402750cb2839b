"""calibration.json: the average over the fitted models."""

from __future__ import annotations

from typing import Any

from calib.average import ModelAverage


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
                "with_parameters": None
                if share.instrument.shared is None
                else share.instrument.shared.with_parameters,
            }
            for share in average.shares
        ]
    }


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
