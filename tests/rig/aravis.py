"""GigE Vision cameras on loopback whose pixels are the virtual world's: Aravis's server, by ctypes.

Needs Debian's libaravis-0.8-0 and addresses of its own; see `namespace`.
"""

from __future__ import annotations

import ctypes as c
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

ADDRESSES = {"c1": "127.0.0.1", "c2": "127.0.0.2"}
INSIDE = "ip link set lo up && ip addr add 127.0.0.2/8 dev lo"

_P = c.c_void_p
_FILL = c.CFUNCTYPE(None, _P, _P, c.c_uint32, c.c_uint32, c.c_uint32)


def library():
    """Return Aravis with the types of what is called."""
    found = c.CDLL("libaravis-0.8.so.0")
    found.arv_gv_fake_camera_new.restype = _P
    found.arv_gv_fake_camera_new.argtypes = [c.c_char_p, c.c_char_p]
    found.arv_gv_fake_camera_is_running.argtypes = [_P]
    found.arv_gv_fake_camera_get_fake_camera.restype = _P
    found.arv_gv_fake_camera_get_fake_camera.argtypes = [_P]
    found.arv_fake_camera_set_fill_pattern.argtypes = [_P, _FILL, _P]
    found.arv_buffer_get_data.restype = _P
    found.arv_buffer_get_data.argtypes = [_P, _P]
    return found


class Server:
    """One fake camera; `picture()` is called for every frame that it sends."""

    def __init__(self, aravis, address, serial, picture):
        self.frames = 0

        def fill(buffer, *_):
            pixels = np.ascontiguousarray(picture())
            self.frames += 1
            c.memmove(aravis.arv_buffer_get_data(buffer, None), pixels.ctypes.data, pixels.size)

        self._fill = _FILL(fill)
        self._camera = aravis.arv_gv_fake_camera_new(address.encode(), serial.encode())
        if not aravis.arv_gv_fake_camera_is_running(self._camera):
            raise RuntimeError(f"no server at {address}")
        fake = aravis.arv_gv_fake_camera_get_fake_camera(self._camera)
        aravis.arv_fake_camera_set_fill_pattern(fake, self._fill, None)


def unavailable():
    """Return why cameras cannot be served here; None if they can."""
    try:
        library()
    except OSError as error:
        return f"{error}; Debian: apt-get install libaravis-0.8-0"
    if missing := [name for name in ("unshare", "ip") if shutil.which(name) is None]:
        return f"{missing[0]} is not installed; Debian: apt-get install iproute2 util-linux"
    probe = subprocess.run(
        ["unshare", "-rn", "sh", "-c", INSIDE], capture_output=True, text=True, check=False
    )
    if probe.returncode:
        return f"the system refuses network namespaces ({probe.stderr.strip()})"
    return None


def namespace(record_property, script, *arguments, timeout_s=300):
    """Run a script in a network namespace of its own with two loopback addresses.

    Returns its standard output, or None where that cannot be: then the summary of the tests says
    so, and in the project's own environment (CI=true) it is an error.
    """
    if reason := unavailable():
        assert os.environ.get("CI") != "true", f"needed here: {reason}"
        record_property("not tested", f"drivers against cameras on loopback: {reason}")
        return None
    command = f'{INSIDE} && exec "$0" "$@"'
    done = subprocess.run(
        ["unshare", "-rn", "sh", "-c", command, sys.executable, str(script), *arguments],
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parent)},
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    return done.stdout
