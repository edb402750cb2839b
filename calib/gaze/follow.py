"""Following a target from picture to picture of C1 by optical flow.

Flow says where to look and how fast the target goes. It never enters a measurement: that is the
target's own detector's.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.images.detection.picture import Grey
from calib.rig.protocols import Frame, Nanoseconds

WINDOW_PX, LEVELS = 21, 3
"""Window and pyramid of the Lucas-Kanade flow, which follows 40 px between pictures."""

BACK_PX: Final = 0.5
"""Flow forth and back must end so near to where it began."""

ALIKE_SHARE: Final = 0.5
"""Windows differ by less than this share of the first one's contrast, or show different things."""

MEMORY: Final = 4
"""Positions by which the velocity is told."""

_S: Final = 1e-9


@dataclass(frozen=True)
class Track:
    """Where the target was seen in C1, newest last.

    Parameters
    ----------
    picture
        The newest picture.
    moments_ns
        When each was exposed, up to `MEMORY` of them.
    pixels
        Where the target was, px, shape (n, 2).
    """

    picture: Grey
    moments_ns: tuple[Nanoseconds, ...]
    pixels: FloatArray = field(repr=False)

    @property
    def velocity(self) -> FloatArray:
        """Pixels a second, shape (2,), by a straight line through the positions kept."""
        if len(self.moments_ns) < 2:
            return np.zeros(2)
        t = _S * (np.array(self.moments_ns) - self.moments_ns[-1])
        t = t - t.mean()
        slope: FloatArray = t @ (self.pixels - self.pixels.mean(axis=0)) / (t @ t)
        return slope

    def at(self, moment: Nanoseconds) -> FloatArray:
        """Return where the target will be at a moment, px, shape (2,)."""
        ahead: FloatArray = self.pixels[-1] + _S * (moment - self.moments_ns[-1]) * self.velocity
        return ahead


def start(frame: Frame, pixel: FloatArray) -> Track:
    """Return the track of a target that its detector has found."""
    return Track(frame.pixels, (frame.exposed_ns,), pixel[None].copy())


def seen(track: Track, frame: Frame, pixel: FloatArray) -> Track:
    """Return the track with a position by the target's own detector."""
    return replace(
        track,
        picture=frame.pixels,
        moments_ns=(*track.moments_ns, frame.exposed_ns)[-MEMORY:],
        pixels=np.vstack([track.pixels, pixel])[-MEMORY:],
    )


def flowed(track: Track, frame: Frame) -> Track | None:
    """Return the track with the next picture's position by flow; None if it is lost."""
    first = track.pixels[-1].astype(np.float32).reshape(1, 1, 2)
    guess = track.at(frame.exposed_ns).astype(np.float32).reshape(1, 1, 2)
    window = (WINDOW_PX, WINDOW_PX)
    there, found, unlike = cv2.calcOpticalFlowPyrLK(
        track.picture, frame.pixels, first, guess.copy(),
        winSize=window, maxLevel=LEVELS, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    if not found[0, 0] or unlike[0, 0] > ALIKE_SHARE * _contrast(track.picture, track.pixels[-1]):
        return None
    back, found, _ = cv2.calcOpticalFlowPyrLK(
        frame.pixels, track.picture, there, there.copy(), winSize=window, maxLevel=LEVELS
    )
    if not found[0, 0] or np.hypot(*(back - first).ravel()) > BACK_PX:
        return None
    return seen(track, frame, there.reshape(2).astype(np.float64))


def _contrast(picture: Grey, pixel: FloatArray) -> float:
    """Return the standard deviation of the grey values in the window around a pixel."""
    u, v = (round(float(x)) for x in pixel)
    half = WINDOW_PX // 2
    part = picture[max(0, v - half) : v + half + 1, max(0, u - half) : u + half + 1]
    return float(part.std()) if part.size else 0.0
