"""The picture file of a guided capture at the terminal: the newest picture with the outline."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from calib.capture.guidance.asked import AskedPose, Role
from calib.images.detection.picture import Grey
from calib.stages.files import write_bytes

FILE: Final = "guide.png"
EVERY_S: Final = 0.5

COLOUR: Final = (127, 0, 224)
FIRST: Final = (40, 160, 0)
"""Of the outline, and of its corner where the board's first corner belongs; BGR."""


class OutlineFile:
    """Writes the file, no more often than a viewer is looked at.

    Parameters
    ----------
    path
        Where.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._at = -EVERY_S

    def show(self, asked: AskedPose | None, pictures: Mapping[Role, Grey], fault: str) -> None:
        """Draw what is asked for; None deletes the file."""
        if asked is None:
            self._path.unlink(missing_ok=True)
            return
        now = time.monotonic()
        if now - self._at < EVERY_S:
            return
        self._at = now
        _, data = cv2.imencode(".png", drawn(pictures[asked.role], asked, fault))
        write_bytes(self._path, data.tobytes())


def drawn(grey: Grey, asked: AskedPose, fault: str) -> np.typing.NDArray[np.uint8]:
    """Return the picture with the outline and the words, BGR, shape (height, width, 3)."""
    picture: np.typing.NDArray[np.uint8] = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    unit = max(1, round(grey.shape[1] / 640))
    outline = np.round(asked.outline_px).astype(np.int32)
    cv2.polylines(picture, [outline], True, (255, 255, 255), 4 * unit, cv2.LINE_AA)
    cv2.polylines(picture, [outline], True, COLOUR, 2 * unit, cv2.LINE_AA)
    first = tuple(int(v) for v in np.round(asked.corners_px[0]))
    cv2.circle(picture, first, 6 * unit, FIRST, 2 * unit, cv2.LINE_AA)
    for row, text in enumerate((asked.why, fault)):
        at = (8 * unit, (18 + 20 * row) * unit)
        for colour, width in (((255, 255, 255), 4), ((0, 0, 0), 1)):
            cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5 * unit, colour,
                        width * unit, cv2.LINE_AA)  # fmt: skip
    return picture
