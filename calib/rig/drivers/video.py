"""Webcams, files and network streams, by OpenCV: the driver "video", no extra.

`cv2.VideoCapture` hands out whatever lies in its queue: after a pause of one second a frame was
1.1 s old. A thread therefore reads all the time and keeps the newest frame with the time of its
arrival; a frame counts as exposed after a moment only if it arrived later than that by the latency
of the stream and was not read off a backlog. Compressed streams are marked as lossy: their pictures
are good for setting up and watching, not for metrology.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from calib.core.errors import InputError
from calib.dataset.fields import Line, NotNegative, Positive
from calib.rig.clock import NS_PER_S
from calib.rig.options import Options, options
from calib.rig.protocols import Camera, Frame, Lost, Nanoseconds, Refused

LATENCY_MS: Final = 500.0
"""From the begin of an exposure to its arrival, unless rig.toml says what `calib rig check`
measured; longer than any webcam in use, network cameras excepted."""

BACKLOG_SHARE: Final = 0.5
"""A frame that comes sooner after the last than this share of the usual interval was waiting."""

MANUAL: Final = {
    "exposure": (cv2.CAP_PROP_AUTO_EXPOSURE, 1.0),
    "focus": (cv2.CAP_PROP_AUTOFOCUS, 0.0),
    "white balance": (cv2.CAP_PROP_AUTO_WB, 0.0),
}
"""What must not change between two pictures, and the value that says it does not (Video4Linux)."""

_REMEMBERED: Final = 60
"""Frames from whose intervals the usual one is taken, the upper quartile."""

_STARTING_NS: Final = NS_PER_S
"""What comes within a second of opening may have lain in a queue."""

UNCOMPRESSED: Final = ("YUY2", "YUYV", "UYVY", "GREY", "Y800", "Y8  ", "NV12", "BGR3", "RGB3")
"""Codes of pixel formats that lose nothing, as far as grey values go."""


class VideoOptions(Options):
    """Keys of the driver.

    Parameters
    ----------
    device
        Number of a local camera, or
    address
        of a stream, such as ``http://host/stream.mjpg``.
    latency_ms
        From the begin of an exposure to its arrival, at the most.
    fps
        Asked of the camera; None keeps its own.
    lossy
        "refused": pictures of a stream that is compressed, or whose exposure, focus or white
        balance cannot be fixed, are shown, but none is handed out for measuring; "accepted": they
        are.
    """

    device: Annotated[int, Field(strict=True, ge=0)] | None = None
    address: Line | None = None
    latency_ms: Positive = LATENCY_MS
    fps: NotNegative | None = None
    lossy: Annotated[str, Field(pattern="^(refused|accepted)$")] = "refused"


@dataclass(frozen=True)
class _Arrived:
    pixels: NDArray[np.uint8]
    arrived_ns: Nanoseconds
    number: int
    waiting: bool


class VideoCamera:
    """A stream with a thread that reads it all the time."""

    def __init__(
        self, capture: Any, own: VideoOptions, size: tuple[int, int], identity: str
    ) -> None:
        self._capture = capture
        self._own = own
        self._size = size
        self._identity = identity
        self.flaws = _flaws(capture, own)
        self._newest: _Arrived | None = None
        self._ended = False
        self._closing = threading.Event()
        self._changed = threading.Condition()
        self._reader = threading.Thread(target=self._read, name="video", daemon=True)
        self._reader.start()

    @property
    def identity(self) -> str:
        """Where the stream comes from, and whether it may be measured in."""
        if not self.flaws:
            return self._identity
        return f"{self._identity} (not for metrology: {', '.join(self.flaws)})"

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self._size

    def after(self, moment: Nanoseconds, *, timeout_s: float) -> Frame:
        """Return a whole frame whose exposure began after `moment`; see `Camera.after`."""
        if self.flaws and self._own.lossy == "refused":
            raise Refused(
                f"{self.identity}: edges in its pictures may move; take an uncompressed format and "
                'fixed settings, or write lossy = "accepted" in rig.toml'
            )
        latency = round(self._own.latency_ms * 1e6)
        deadline = time.monotonic_ns() + round(timeout_s * NS_PER_S)
        with self._changed:
            while not self._ended:
                newest = self._newest
                if newest and not newest.waiting and newest.arrived_ns - latency > moment:
                    return _frame(newest, newest.arrived_ns - latency)
                left = deadline - time.monotonic_ns()
                if left <= 0:
                    break
                self._changed.wait(left / NS_PER_S)
        reason = "the stream has ended" if self._ended else "none came"
        raise Lost(
            f"{self.identity}: no frame exposed after the asked moment within {timeout_s:g} s "
            f"({reason}); timeout must exceed latency_ms = {self._own.latency_ms:g}"
        )

    def latest(self) -> Frame | None:
        """Return the newest frame, for display only."""
        with self._changed:
            newest = self._newest
        return None if newest is None else _frame(newest, newest.arrived_ns)

    def close(self) -> None:
        """Let go of the device."""
        self._closing.set()
        self._reader.join(timeout=5.0)
        self._capture.release()

    def _read(self) -> None:
        intervals: deque[Nanoseconds] = deque(maxlen=_REMEMBERED)
        opened = last = time.monotonic_ns()
        number = 0
        while not self._closing.is_set():
            is_good, picture = self._capture.read()
            now = time.monotonic_ns()
            intervals.append(now - last)
            usual = float(np.percentile(intervals, 75))
            waiting = now - opened < _STARTING_NS or now - last < BACKLOG_SHARE * usual
            with self._changed:
                self._ended = not is_good
                if is_good:
                    self._newest = _Arrived(_grey(picture), now, number, waiting)
                self._changed.notify_all()
            if not is_good:
                return
            last, number = now, number + 1


def _grey(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    grey: NDArray[np.uint8] = picture
    if picture.ndim == 3 and picture.shape[2] == 3:
        grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)
    return grey


def _frame(arrived: _Arrived, exposed_ns: Nanoseconds) -> Frame:
    return Frame(arrived.pixels, exposed_ns, "arrival", arrived.number)


def _flaws(capture: Any, own: VideoOptions) -> tuple[str, ...]:
    """Return what speaks against measuring in a stream; what cannot be told counts as a flaw."""
    code = int(capture.get(cv2.CAP_PROP_FOURCC))
    name = "".join(chr((code >> 8 * k) & 0xFF) for k in range(4))
    lossy = own.address is not None or name not in UNCOMPRESSED
    # 0 and -1 mean that the camera has no such automatic.
    automatic = [
        f"automatic {what}"
        for what, (key, value) in MANUAL.items()
        if own.device is not None and capture.get(key) not in (value, 0.0, -1.0)
    ]
    return ("lossy", *automatic) if lossy else tuple(automatic)


def open_camera(settings: Mapping[str, Any]) -> Camera:
    """Open a stream; the driver "video".

    Raises
    ------
    InputError
        If its section has a wrong key, or the stream has another size.
    Lost
        If it does not open.
    """
    own = options(VideoOptions, settings)
    where = f"rig.toml, [cameras.{settings.get('role', 'c1')}]"
    if (own.device is None) == (own.address is None):
        raise InputError.single(
            where=where,
            what="needs device or address, and not both",
            remedy='write device = 0 for a local camera, address = "http://..." for a stream',
        )
    source = own.device if own.device is not None else own.address
    capture: Any = cv2.VideoCapture()
    capture.open(source)
    if not capture.isOpened():
        raise Lost(f"{where}: {source} does not open; is it connected, and free?")
    wanted: tuple[int, int] | None = settings.get("image_size")
    _ask_for(capture, own, wanted)
    size = tuple(int(capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if wanted is not None and size != tuple(wanted):
        capture.release()
        raise InputError.single(
            where=f"{where} image_size",
            what=f"the stream is {size[0]} x {size[1]}, not {wanted[0]} x {wanted[1]}",
            remedy="write the size of the stream",
        )
    return VideoCamera(capture, own, (size[0], size[1]), f"video {source}")


def _ask_for(capture: Any, own: VideoOptions, size: tuple[int, int] | None) -> None:
    """Ask a local camera for a fixed exposure and focus, and for the size."""
    if own.device is None:
        return
    if size is not None:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
    if own.fps:
        capture.set(cv2.CAP_PROP_FPS, own.fps)
    for key, value in MANUAL.values():
        capture.set(key, value)
