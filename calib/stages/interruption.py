"""Signals that end a run become KeyboardInterrupt, at a moment when it is not lost.

Python swallows what is raised while an object is finalised: the message "Exception ignored in ..."
appears, and the run goes on as if nothing had been asked of it.
"""

from __future__ import annotations

import signal
from types import FrameType

AGAIN_S = 0.01
"""Wait for a finaliser to end."""

_FINALISERS = frozenset({"__del__"})
_FILES = ("weakref.py", "_weakrefset.py")


def interrupt_on(*signals: signal.Signals) -> None:
    """Let these signals raise KeyboardInterrupt in the main thread, out of finalisers only."""
    for each in (*signals, signal.SIGALRM):
        signal.signal(each, _interrupt)


def _interrupt(_: int, frame: FrameType | None) -> None:
    if _is_finalising(frame):
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        return
    raise KeyboardInterrupt


def _is_finalising(frame: FrameType | None) -> bool:
    while frame is not None:
        code = frame.f_code
        if code.co_name in _FINALISERS or code.co_filename.endswith(_FILES):
            return True
        frame = frame.f_back
    return False
