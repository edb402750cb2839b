"""OpenCV as a library should be: quiet, and the same result in every run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2


@contextmanager
def steady_opencv() -> Iterator[None]:
    """Keep OpenCV to one thread a call, and its log off the user's terminal, for a while.

    With several threads its calibration sums in whatever order they finish: the last four digits
    of the result then differ from run to run. In detection they gain little.
    """
    threads, level = cv2.getNumThreads(), cv2.utils.logging.getLogLevel()
    cv2.setNumThreads(1)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
        cv2.utils.logging.setLogLevel(level)
