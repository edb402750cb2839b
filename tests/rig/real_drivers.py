"""Run in a network namespace: drivers gige and ximc, pixels of the virtual world behind them.

Only frames and step counts cross to the drivers. Prints one JSON object of what was seen.
"""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
import threading
import time
from contextlib import contextmanager

import numpy as np
from aravis import ADDRESSES, Server, library

from calib.geometry.plane import gaze_at
from calib.rig.clock import HostClock
from calib.rig.devices import open_rig
from calib.rig.settings import RigSettings
from calib.rig.virtual.operator import Operator
from calib.rig.virtual.world import World

STEP_DEG = 0.05625


def settings(seed, folder):
    """Return rig.toml of two GigE cameras and the vendor's virtual controller."""
    cameras = {
        name: {
            "driver": "gige",
            "image_size": (640, 480),
            "address": address,
            "local_address": address,
            "exposure_us": 1000.0,
        }
        for name, address in ADDRESSES.items()
    }
    return RigSettings.model_validate(
        {
            "format": 1,
            "serial": f"loopback-{seed}",
            "cameras": cameras,
            "axis": {
                "driver": "ximc",
                "device": f"xi-emu://{folder}/yaw.bin",
                "reads": "counts",
                "resolution_deg": STEP_DEG,
                "step_deg": STEP_DEG,
                "full_step_deg": 0.9,
            },
            "virtual": {"seed": seed, "baseline_mm": 200.0, "axis_z_mm": -20.0},
        }
    )


class Painter:
    """Pictures of this moment, rendered anew only where something moved, noise on top."""

    def __init__(self, world, name, seed):
        self._world, self._name = world, name
        self._rng = np.random.default_rng([seed, name == "c2"])
        self._noise = self._rng.normal(0, 1.5, 2 * 640 * 480).astype(np.float32)
        self._seen, self._clean = None, None

    def picture(self):
        moment = time.monotonic_ns()
        pose = self._world.seen(self._name, moment)
        if self._clean is None or not np.array_equal(pose, self._seen):
            clean = self._world.picture(self._name, moment, 0, Silent())
            self._seen, self._clean = pose, clean.astype(np.float32)
        start = self._rng.integers(640 * 480)
        noise = self._noise[start : start + self._clean.size].reshape(self._clean.shape)
        return np.clip(np.rint(self._clean + noise), 0, 255).astype(np.uint8)


class Silent:
    """Draws no noise."""

    def standard_normal(self, shape, _):
        return np.zeros(shape, np.float32)


@contextmanager
def loopback_rig(seed):
    """Open the rig with its world behind it."""
    with tempfile.TemporaryDirectory() as folder:
        parsed = settings(seed, folder)
        world = World(parsed, HostClock())
        aravis = library()
        # Until the axis is open it stands at its zero.
        servers = [
            Server(aravis, address, f"CALIB-{name}", Painter(world, name, seed).picture)
            for name, address in ADDRESSES.items()
        ]
        with open_rig(parsed) as rig:
            controller = rig.axis._controller
            world.turn_by(lambda _: math.pi / 2 + math.radians(STEP_DEG) * controller.state().steps)
            yield rig, world, Operator(world), servers


def devices(rig, world, operator, servers):
    """Return what the devices do, for the tests to judge."""
    seen = {
        "identities": [d.identity for d in (rig.c1, rig.c2, rig.axis)],
        "sizes": [rig.c1.image_size, rig.c2.image_size],
    }
    operator.show_gaze()
    reading = float(gaze_at(world.rig.theta, world.target(time.monotonic_ns())[None]).alpha2[0])
    frames = []
    for k in range(8):
        standing = rig.axis.move(reading + math.radians(1.0 * (k % 3)))
        frame = rig.c2.after(standing.since_ns, timeout_s=30)
        frames.append(
            {
                "late_ms": (frame.exposed_ns - standing.since_ns) / 1e6,
                "off": float(
                    np.abs(frame.pixels.astype(int) - now(world, "c2").astype(int)).mean()
                ),
                "sure": frame.sure,
                "reading_off": standing.reading_rad - world.yaw(0),
            }
        )
    seen["frames"] = frames
    seen["negative"] = [rig.axis.move(math.radians(90 - k * STEP_DEG)).counts for k in (1, 17, 801)]
    seen["back"] = rig.axis.standstill().counts
    seen["stopped"] = stopped(rig)
    seen["shown"] = rig.c1.latest() is not None
    seen["sent"] = [server.frames for server in servers]
    return seen


def now(world, name):
    """Return the picture of this moment."""
    return world.picture(name, time.monotonic_ns(), 0, np.random.default_rng(0))


def stopped(rig):
    """Stop a move from another thread; return what came of it."""
    rig.axis.move(math.radians(60))
    slow = rig.axis._controller._axis.get_move_settings()
    slow.Speed = 50
    rig.axis._controller._axis.set_move_settings(slow)
    threading.Timer(0.2, rig.axis.stop).start()
    begin = time.monotonic()
    try:
        rig.axis.move(math.radians(130))
    except Exception as error:
        name = type(error).__name__
    else:
        name = "arrived"
    return {
        "error": name,
        "reading": rig.axis.standstill().reading_rad,
        "took_s": time.monotonic() - begin,
    }


if __name__ == "__main__":
    with loopback_rig(int(sys.argv[1])) as (rig, world, operator, servers):
        result = devices(rig, world, operator, servers)
    sys.stdout.write(json.dumps(result))
    sys.stdout.flush()
    os._exit(0)  # Aravis's threads have no end
