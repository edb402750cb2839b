"""Virtual rigs in simulated time for tests; what `[virtual]` and `[axis]` say differs."""

from __future__ import annotations

from contextlib import contextmanager

from calib.geometry.plane import gaze_at
from calib.rig.devices import open_rig
from calib.rig.settings import embedded
from calib.rig.virtual.operator import Operator

OPEN_LOOP = {"reads": "counts", "resolution_deg": 0.05625}


@contextmanager
def virtual_rig(*, axis=None, cameras=None, board=None, **virtual):
    """Open the embedded rig in simulated time, with these changes to its settings."""
    settings = embedded().model_dump(exclude_none=True)
    settings["virtual"] |= {"time": "simulated", **virtual}
    settings["axis"] |= axis or {}
    for camera in ("c1", "c2"):
        settings["cameras"][camera] |= cameras or {}
    if board is not None:
        settings["board"] = board
    with open_rig(embedded().model_validate(settings)) as rig:
        yield rig


def gaze_reading(rig):
    """Return the reading at which C2 gazes at the target that stands there now, rad."""
    point = rig.world.target(rig.clock.now_ns())
    return float(gaze_at(rig.world.rig.theta, point[None]).alpha2[0])


def shown(rig):
    """Put one target up and return the reading that gazes at it."""
    Operator(rig.world).show_gaze()
    return gaze_reading(rig)
