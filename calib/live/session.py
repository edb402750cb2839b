"""A session: one thread that owns motor and devices, and does one job after the other."""

from __future__ import annotations

import math
import sys
import threading
import traceback
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.core.errors import CalibError, UsageError
from calib.gaze import length as lengths
from calib.gaze.picking import target_near
from calib.gaze.table import header
from calib.gaze.target import Target
from calib.live import jobs
from calib.live.bench import Bench, Places, with_axis
from calib.live.commands import DRIVING, REPEATABLE, Answer, Capture, Gaze, Job, Length, Mark, Pick
from calib.live.guarded import GuardedAxis, Stopped
from calib.live.record import Record
from calib.live.scene import heading
from calib.live.streams import Stream
from calib.rig.devices import RigDevices, alone, open_rig
from calib.rig.protocols import Interrupted
from calib.rig.settings import RigSettings

WAITING_MAX: Final = 8
"""Jobs that may wait."""

CLOSE_S: Final = 20.0

THIS_PROGRAM: Final = (sys.executable, "-m", "calib")


@dataclass(frozen=True)
class Given:
    """What a session begins with.

    Parameters
    ----------
    settings
        Of the rig.
    places
        Where things lie.
    calibration
        File to measure with; None for that of the run, if there is one.
    calib
        How the program is called.
    allow_edited, accept_failed
        Whether the user takes a `calibration` that was edited, or whose gates failed.
    """

    settings: RigSettings
    places: Places
    calibration: Path | None = None
    calib: Sequence[str] = THIS_PROGRAM
    allow_edited: bool = False
    accept_failed: bool = False


class Session:
    """The owner of the rig; its methods may be called from any thread.

    with Session(given) as session:
        session.submit(job)
        session.stop()
    """

    def __init__(self, given: Given) -> None:
        self._given = given
        self._lock = threading.RLock()  # a signal's handler may come while it is held
        self._wake = threading.Condition(self._lock)
        self._waiting: deque[Job] = deque()
        self._job: Job | None = None
        self._closing = False
        self._opened = threading.Event()
        self._failed: BaseException | None = None
        self._bench: Bench | None = None
        self._marked: tuple[Target, ...] = ()
        self._thread = threading.Thread(target=self._run, name="rig", daemon=True)
        self.record = Record()
        self.streams: dict[str, Stream] = {}

    def __enter__(self) -> Session:
        """Open the devices; raises what their drivers do."""
        self._thread.start()
        self._opened.wait()
        if self._failed is not None:
            raise self._failed
        return self

    def __exit__(self, *_: object) -> None:
        """Stop, and close the devices."""
        self._try_to_stop()
        with self._wake:
            self._closing = True
            self._wake.notify_all()
        self._thread.join(CLOSE_S)

    @property
    def places(self) -> Places:
        """Where things lie."""
        return self._given.places

    def submit(self, job: Job) -> None:
        """Let a job be done when those before it are.

        Raises
        ------
        UsageError
            If too many wait already, its target is none, the same is at work or waits (a click
            that was doubled), or the rig was closed.
        """
        for name in _targets(job):
            if self._bench is not None:
                self._bench.target(name)
        with self._wake:
            if not self._thread.is_alive():
                raise UsageError("the rig was closed; start the page anew")
            if job in (self._job, *self._waiting) and not isinstance(job, REPEATABLE):
                raise UsageError(f"{jobs.title(job)} is at work or waits already")
            if len(self._waiting) >= WAITING_MAX:
                raise UsageError(f"{WAITING_MAX} jobs wait already")
            self._waiting.append(job)
            self._publish_waiting()
            self._wake.notify_all()

    def answer(self, answer: Answer) -> None:
        """Answer the question of the job at work."""
        self.record.answer(answer.text)

    def mark(self, mark: Mark) -> None:
        """Mark another target in the pictures; raises `UsageError` if it is none."""
        if self._bench is not None:
            self._marked = (self._bench.target(mark.target),)
            self.record.put(marked=mark.target)

    def pick(self, pick: Pick) -> str:
        """Return the name of the target at a place in a picture, and mark it.

        Raises
        ------
        UsageError
            If there is none.
        """
        bench = self._bench
        if bench is None:
            raise UsageError("the rig is not open yet")
        frame = (bench.rig.c1 if pick.camera == "c1" else bench.rig.c2).latest()
        lens = bench.lens(pick.camera)
        place = np.array([pick.u, pick.v])
        name = frame and target_near(frame.pixels, place, board=bench.board, lens=lens)
        if not name:
            raise UsageError(
                "nothing there that can be gazed at: a corner of the board, a tag, a cross, a "
                "disc, a plate's corner"
            )
        self.mark(Mark(do="mark", target=name))
        return name

    def stop(self) -> None:
        """Stop the motor at once, end the job and forget those that wait."""
        with self._lock:
            self._waiting.clear()
            bench = self._bench
        try:
            if bench is not None:
                bench.axis.stop()
        finally:
            # An axis that does not answer is no reason to go on with the job.
            self.record.answer(None)
            with self._lock:
                self._publish_waiting()

    def owner_left(self) -> None:
        """Stop if the motor is at work or soon would be: nobody watches it who could stop it."""
        with self._lock:
            busy = (self._job, *self._waiting)
            is_driving = any(isinstance(job, DRIVING) for job in busy)
        if is_driving:
            self.record.tell("the page that had the motor is gone: stopped", bad=True)
            self._try_to_stop()

    def _try_to_stop(self) -> None:
        """Stop where nobody could be told but by the log."""
        try:
            self.stop()
        except (CalibError, OSError) as error:
            self.record.tell(f"the axis does not obey: {error}", bad=True)

    def measurements_csv(self) -> str:
        """Return all positions as `calib gaze` writes them."""
        return header() + "".join(self._bench.csv if self._bench else ())

    def lengths_csv(self) -> str:
        """Return all lengths as `calib length` writes them."""
        return lengths.header() + "".join(self._bench.lengths_csv if self._bench else ())

    def _run(self) -> None:
        try:
            given = self._given
            with alone(given.places.rig_file, given.settings), open_rig(given.settings) as opened:
                axis = GuardedAxis(opened.axis, self._turned)
                self._begin(with_axis(opened, axis), axis)
                try:
                    self._opened.set()
                    self._work()
                finally:
                    for stream in self.streams.values():
                        stream.close()
        except BaseException as error:
            self._failed = error
            self.record.put(job=None)
            self.record.tell(f"the rig was closed: {error}", bad=True)
        finally:
            self._opened.set()

    def _begin(self, rig: RigDevices, axis: GuardedAxis) -> None:
        given = self._given
        bench = Bench(rig, axis, given.places, self.record, given.calib)
        self.record.put(
            rig={
                "serial": rig.serial,
                "virtual": rig.world is not None,
                "board": bench.board is not None,
                "u_alpha2_deg": given.settings.axis.u_alpha2_deg,
                "devices": [rig.c1.identity, rig.c2.identity, axis.identity],
                "range_deg": [math.degrees(end) for end in axis.range_rad],
                "dataset": str(given.places.dataset),
                "run": str(given.places.run),
            }
        )
        for role, camera in (("c1", rig.c1), ("c2", rig.c2)):
            centre = bench.centre_column if role == "c2" else lambda: None
            self.streams[role] = Stream(
                camera, rig.clock, lambda: self._marked, centre, partial(self._seen, role)
            )
        if bench.board is not None:
            self._marked = (bench.target("board"),)
            self.record.put(marked="board")
        jobs.look_around(bench)
        self._first_calibration(bench)
        bench.draw()
        self._bench = bench
        if rig.world is not None:
            bench.hand("board" if bench.board else given.settings.virtual.target).place("first")
        axis.standstill()
        for stream in self.streams.values():
            stream.start()

    def _first_calibration(self, bench: Bench) -> None:
        """Take the calibration that was given into use, or else that of the last run."""
        if self._given.calibration is not None:
            bench.use(
                self._given.calibration,
                allow_edited=self._given.allow_edited,
                accepted=self._given.accept_failed,
            )
            return
        path = self._given.places.run / "calibration.json"
        if path.is_file():
            try:
                bench.use(path)
            except CalibError as error:
                self.record.tell(str(error), bad=True)

    def _seen(self, role: str, fault: str) -> None:
        """Publish why a camera gives no picture; "" once it does."""
        self.record.put(**{f"fault_{role}": fault})

    def _turned(self, reading_rad: float | None) -> None:
        """Publish where C2 stands; None while it turns."""
        if reading_rad is None:
            self.record.put(turning=True)
            return
        found: dict[str, Any] = {"turning": False, "reading_deg": math.degrees(reading_rad)}
        theta = None if self._bench is None else self._bench.theta()
        if theta is not None:
            found["heading"] = heading(theta, reading_rad)
        self.record.put(**found)

    def _work(self) -> None:
        while (job := self._next()) is not None:
            bench = self._bench
            assert bench is not None  # noqa: S101 - set before the first job
            try:
                jobs.run(bench, job)
            except (Interrupted, Stopped) as error:
                self.record.tell(f"{jobs.title(job)}: {error}", bad=not bench.axis.is_stopped)
            except (CalibError, OSError) as error:
                self.record.tell(f"{jobs.title(job)}: {error}", bad=True)
            except Exception as error:
                self._try_to_stop()
                traceback.print_exc()
                self.record.tell(
                    f"{jobs.title(job)}: a fault of the program, {type(error).__name__}: {error}; "
                    "C2 was stopped. The terminal has the details",
                    bad=True,
                )
            finally:
                self.record.put(turning=False)
                with self._lock:
                    self._job = None
                    self.record.put(job=None)

    def _next(self) -> Job | None:
        """Wait for a job, and let the axis move again for it; None ends the session."""
        with self._wake:
            self._wake.wait_for(lambda: self._closing or bool(self._waiting))
            if self._closing or self._bench is None:
                return None
            self._job = self._waiting.popleft()
            self._bench.axis.allow()
            if names := _targets(self._job):
                self._marked = tuple(self._bench.target(name) for name in names)
            self.record.put(
                job={"name": jobs.title(self._job), "step": "", "done": None, "of": None}
            )
            self._publish_waiting()
            return self._job

    def _publish_waiting(self) -> None:
        self.record.put(waiting=[jobs.title(job) for job in self._waiting])


def _targets(job: Job) -> tuple[str, ...]:
    """Return the names of the targets of a job."""
    if isinstance(job, Length):
        return job.start, job.end
    if isinstance(job, Capture | Gaze):
        return (job.target,)
    return ()
