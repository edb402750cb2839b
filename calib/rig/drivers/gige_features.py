"""Features of GigE Vision cameras under the names that standards and makers gave them."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import telegenic

from calib.rig.clock import NS_PER_S
from calib.rig.protocols import Nanoseconds

EXPOSURE_NAMES: Final = ("ExposureTime", "ExposureTimeAbs")
LATCHES: Final = (
    ("TimestampLatch", "TimestampLatchValue"),
    ("GevTimestampControlLatch", "GevTimestampValue"),
)
TRIGGER: Final = "TriggerSoftware"


def pixels_of(frame: telegenic.Frame) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return the picture of a frame, shape (height, width)."""
    flat = np.frombuffer(frame.data(), np.uint8)
    return flat[: frame.width * frame.height].reshape(frame.height, frame.width)


def exposure_ns(camera: telegenic.Camera) -> Nanoseconds:
    """Return the exposure that a camera states, 0 where it states none."""
    for name in EXPOSURE_NAMES:
        if camera.has_feature(name):
            return round(camera.get_float(name) * 1000)
    return 0


def made_triggered(camera: telegenic.Camera) -> bool:
    """Switch to software triggers; return whether the camera has them."""
    if not (camera.has_feature("TriggerMode") and camera.has_feature(TRIGGER)):
        return False
    try:
        if camera.has_feature("TriggerSelector"):
            camera.set_enum("TriggerSelector", "FrameStart")
        camera.set_enum("TriggerSource", "Software")
        camera.set_enum("TriggerMode", "On")
    except telegenic.GenicamError:
        return False
    return camera.get_enum("TriggerMode") == "On"


def latch_of(camera: telegenic.Camera) -> tuple[str, str, float] | None:
    """Return the command that latches the camera's clock, where it stands then, ns a tick."""
    for command, value in LATCHES:
        if camera.has_feature(command) and camera.has_feature(value):
            ticks_per_s = NS_PER_S
            if camera.has_feature("GevTimestampTickFrequency"):
                ticks_per_s = camera.get_integer("GevTimestampTickFrequency")
            return command, value, NS_PER_S / ticks_per_s
    return None
