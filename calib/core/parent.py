"""Processes that end with the one that started them, however that ends.

What is killed cannot tell its children. So these ask the kernel to be killed in turn (Linux,
``prctl(2)``, PR_SET_PDEATHSIG): at once, also while they compute and say nothing. Nothing on disk
is harmed, as each file appears whole or not at all. Where the kernel has no such call they notice
at their next word to the one who has gone.
"""

from __future__ import annotations

import os
import signal
import sys

VARIABLE = "CALIB_PARENT"
"""Names the process to end with, for the one process that it starts."""

_PR_SET_PDEATHSIG = 1


def ending_with_this() -> dict[str, str]:
    """Return what the environment of a process needs that is to end with this one."""
    return {VARIABLE: str(os.getpid())}


def end_with_parent() -> None:
    """Let this process end with the one that started it, if that asked for it."""
    parent = os.environ.pop(VARIABLE, "")
    if not parent or not sys.platform.startswith("linux"):
        return
    import ctypes  # not every start of the program needs it

    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    try:
        os.kill(int(parent), 0)
    except ProcessLookupError:  # it ended before the kernel was asked
        os.kill(os.getpid(), signal.SIGKILL)
