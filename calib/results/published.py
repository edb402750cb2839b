"""Estimates by the names under which a dataset states published values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from calib.geometry.camera import intrinsic_names, intrinsic_vector
from calib.geometry.poses import invert_pose
from calib.images.result import ImageResult

CONTRADICTION = 3.0
"""Difference over its standard uncertainty from which on it is told: of some fourteen quantities
one in 25 runs by chance."""


def contradictions(
    images: ImageResult, published: Mapping[str, tuple[float, float]]
) -> Iterator[str]:
    """Yield published values that the images contradict, in one line.

    Parameters
    ----------
    published
        Value and standard uncertainty by quantity.
    """
    found, told = image_estimates(images), []
    for name, (value, u) in published.items():
        if name in found:
            here, own = found[name]
            score = (here - value) / float(np.hypot(own, u))
            if abs(score) > CONTRADICTION:
                told.append(f"{name} {here:.6g} +- {own:.2g} for {value:g} +- {u:g} ({score:+.1f})")
    if told:
        yield (
            f"the pictures contradict [published]: {'; '.join(told)}, differences in standard "
            "uncertainties: another state of the cameras, another convention (pixels from the "
            "centre or the edge of the first one, C1 in C2 or C2 in C1, the board's squares), or "
            "an uncertainty that is too small"
        )


def image_estimates(images: ImageResult) -> dict[str, tuple[float, float]]:
    """Return value and standard uncertainty by quantity."""
    found: dict[str, tuple[float, float]] = {}
    for camera, result in images.intrinsics.items():
        names = intrinsic_names(result.camera)
        values, std = intrinsic_vector(result.camera), np.sqrt(np.diag(result.covariance))
        for name, value, u in zip(names, values, std, strict=True):
            found[f"{camera}.{name}"] = float(value), float(u)
    if images.stereo is not None:
        pose, covariance = invert_pose(images.stereo.pose_12, images.stereo.covariance)
        kinds = [f"rotation_{axis}_rad" for axis in "xyz"]
        kinds += [f"translation_{axis}_mm" for axis in "xyz"]
        for i, kind in enumerate(kinds):
            found[f"c1_in_c2.{kind}"] = float(pose[i]), float(np.sqrt(covariance[i, i]))
    return found
