"""All that the image half of the chain found out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from calib.geometry.board import Corners
from calib.images.contact_sheet import ContactSheet
from calib.images.intrinsics.calibrate import Intrinsics
from calib.images.stereo.reference import StereoReference
from calib.images.sweep.yaw_axis import SweepResult


@dataclass(frozen=True)
class ImageResult:
    """Results by camera, "c1" and "c2"; empty or None where the dataset has no data for them.

    `pairs` names the two pictures of each pair, C1's first.
    """

    corners: Mapping[str, Corners]
    sheets: Mapping[str, ContactSheet]
    intrinsics: Mapping[str, Intrinsics]
    stereo: StereoReference | None
    sweep: SweepResult | None
    pairs: Mapping[str, tuple[str, str]] = field(default_factory=dict)
