"""A lens as sections of dataset.toml and rig.toml state it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from calib.geometry.camera import Camera
from calib.geometry.lens import ProjectionName


class GivenLens(Protocol):
    """A section of dataset.toml or rig.toml that may state a lens."""

    @property
    def matrix(self) -> Sequence[Sequence[float]] | None:
        """Camera matrix, px."""

    @property
    def distortion(self) -> Sequence[float] | None:
        """Coefficients in OpenCV's order."""

    @property
    def projection(self) -> ProjectionName | None:
        """Of which lens model they are; None for perspective."""


def stated_camera(section: GivenLens | None, image_size: tuple[int, int]) -> Camera | None:
    """Return the camera that a section states; None if it states none."""
    if section is None or section.matrix is None:
        return None
    lens = np.array(section.distortion or (), dtype=np.float64)
    return Camera(np.array(section.matrix), lens, image_size, section.projection or "perspective")


def camera_section(camera: Camera) -> dict[str, Any]:
    """Return a camera as a section states it."""
    return {
        "image_size": list(camera.image_size),
        "matrix": camera.matrix.tolist(),
        "distortion": camera.distortion.tolist(),
    } | ({} if camera.projection == "perspective" else {"projection": camera.projection})
