"""Pictures to look at: the newest of a camera as JPEG, with the target marked; never measured."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from calib.core.errors import CalibError
from calib.gaze.target import Target
from calib.rig.clock import Clock
from calib.rig.protocols import Camera, Frame

INTERVAL_S: Final = 0.1
SHARE: Final = 0.5
"""A stream rests for at least its own work divided by this: measuring goes before looking."""

REST_MAX_S: Final = 1.0

IDLE_S: Final = 5.0
"""A camera that has nothing new is looked at for so long after the last page has asked; pages that
wait ask again meanwhile."""

SAME_S: Final = 0.25
QUALITY: Final = 80


@dataclass(frozen=True)
class ShownPicture:
    """A picture as pages get it.

    Parameters
    ----------
    number
        Grows from picture to picture.
    serial
        The camera's number of the frame.
    jpeg
        The picture.
    size
        Width and height, px.
    exposed_ns
        As the camera's driver puts it, by the rig's clock.
    target
        Where the target is, px; None if it is not seen.
    marks
        Points by which it was found, a board's corners, px.
    centre_px
        The camera's centre column, px; None to draw none.
    """

    number: int
    serial: int
    jpeg: bytes
    size: tuple[int, int]
    exposed_ns: int
    target: tuple[float, float] | None
    marks: list[list[float]]
    centre_px: float | None


class Stream:
    """One camera's pictures, made while somebody asks for them.

    Parameters
    ----------
    camera
        The device.
    clock
        The rig's.
    targets
        Returns what is to be marked; the first that is seen is the target.
    centre
        Returns the centre column, px; None draws none.
    told
        Told why the camera gives no picture, and "" once it gives one again.
    """

    def __init__(
        self,
        camera: Camera,
        clock: Clock,
        targets: Callable[[], Sequence[Target]],
        centre: Callable[[], float | None],
        told: Callable[[str], None],
    ) -> None:
        self._camera = camera
        self._clock = clock
        self._targets = targets
        self._centre = centre
        self._told = told
        self._asked = threading.Event()
        self._asked_at = 0.0
        self._closing = threading.Event()
        self._listeners: list[Callable[[], None]] = []
        self._thread = threading.Thread(target=self._run, name="stream", daemon=True)
        self.shown: ShownPicture | None = None

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """End, before the camera is closed."""
        self._closing.set()
        self._asked.set()
        self._thread.join(timeout=10.0)

    def listen(self, listener: Callable[[], None]) -> None:
        """Call `listener` when there is a new picture, from the stream's thread."""
        self._listeners.append(listener)

    def ask(self) -> None:
        """Say that somebody waits for a picture."""
        self._asked_at = time.monotonic()
        self._asked.set()

    def age_ms(self, shown: ShownPicture) -> float:
        """Return how old a picture is now, ms."""
        return max(0.0, (self._clock.now_ns() - shown.exposed_ns) / 1e6)

    def _run(self) -> None:
        while True:
            self._asked.wait()
            if self._closing.is_set():
                return
            # Cleared before the picture is taken: who asks from now on wants the one after it.
            self._asked.clear()
            began = time.monotonic()
            is_new = self._next()
            ended = time.monotonic()
            if not is_new and ended - self._asked_at < IDLE_S:
                self._asked.set()
            worked = ended - began
            rest = max(INTERVAL_S if is_new else SAME_S, worked / SHARE) - worked
            self._closing.wait(min(rest, REST_MAX_S))

    def _next(self) -> bool:
        """Make the next picture; return whether it is another one."""
        is_new, fault = False, ""
        try:
            is_new = self._renew()
        except (CalibError, OSError) as error:
            fault = str(error)
        except Exception as error:
            # The pictures go on where they can.
            fault = f"a fault of the program, {type(error).__name__}: {error}"
        self._told(fault)
        if is_new:
            for listener in self._listeners:
                listener()
        return is_new

    def _renew(self) -> bool:
        frame, before = self._camera.latest(), self.shown
        if frame is None or (before is not None and before.serial == frame.serial):
            return False
        self.shown = self._made(frame, 1 if before is None else before.number + 1)
        return True

    def _made(self, frame: Frame, number: int) -> ShownPicture:
        looked = (target.find(frame.pixels) for target in self._targets())
        seen = [observation for observation in looked if observation is not None]
        _, data = cv2.imencode(".jpg", frame.pixels, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        height, width = frame.pixels.shape
        points = np.concatenate([np.empty((0, 2)), *(observation.marks_px for observation in seen)])
        points = points[np.isfinite(points).all(axis=1)]
        return ShownPicture(
            number=number,
            serial=frame.serial,
            jpeg=data.tobytes(),
            size=(width, height),
            exposed_ns=frame.exposed_ns,
            target=(float(seen[0].pixel[0]), float(seen[0].pixel[1])) if seen else None,
            marks=points.round(1).tolist(),
            centre_px=self._centre(),
        )
