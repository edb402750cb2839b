"""Lens models that the intrinsics of a camera are solved with: one entry each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from calib.geometry.camera import Camera
from calib.geometry.lens import ProjectionName


@dataclass(frozen=True)
class Lens:
    """A lens model to solve with: its projection and its number of coefficients."""

    projection: ProjectionName
    count: int


LENSES: Mapping[str, Lens] = MappingProxyType(
    {
        "equidistant": Lens("equidistant", 4),
        "plumb-bob": Lens("perspective", 5),
        "rational": Lens("perspective", 8),
    }
)
"""Lens models tried, simplest first; equidistant only where pictures show a wide lens."""

PERSPECTIVE: Mapping[str, int] = MappingProxyType(
    {name: lens.count for name, lens in LENSES.items() if lens.projection == "perspective"}
)
"""Those of OpenCV's pinhole and of mrcal, with their number of coefficients."""

WIDE = "equidistant"
"""The one that this program solves itself (`by_views`), OpenCV's cv2.fisheye beside it."""


def lens_of(camera: Camera) -> str:
    """Return the name of the lens model of a camera that was solved."""
    found = Lens(camera.projection, len(camera.distortion))
    return next(name for name, lens in LENSES.items() if lens == found)
