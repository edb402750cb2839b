"""What the virtual rig stands in: the true rig, the target before it, the light.

Targets are placed by whoever plays the operator (`calib.rig.virtual.operator`); cameras ask for the
picture of an exposure, the motor says where C2 stood at a moment. What is true is kept here and
goes, if asked for, to a file line by line; nothing but tests may read it.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import UsageError
from calib.dataset.board_section import board_of
from calib.dataset.lens_section import camera_section, stated_camera
from calib.geometry.board import Board
from calib.geometry.camera import Camera
from calib.geometry.mirror import SIGN
from calib.geometry.parameters import INDEX, NAMES
from calib.rig.clock import Clock
from calib.rig.protocols import Nanoseconds
from calib.rig.settings import CameraSection, RigSettings
from calib.rig.virtual.targets import sheet
from calib.simulate.render import Image, Imager, Optics, expose, prepare
from calib.simulate.rig import Noise, TrueRig, c2_pose, draw_camera, draw_rig, mirror_rig
from calib.simulate.scene import fitting_board, invert, target_in_c1

CameraName = Literal["c1", "c2"]

DEFAULT_SIZE: Final = (640, 480)
WHITE_GREY: Final = 250.0
RAY_SPACING_PX: Final = 8

BLUR_STEP_PX: Final = 1.0
BLUR_MOST: Final = 12
"""An exposure in motion is the mean of pictures so far apart, or of so many."""

TRUTH_BEGINS: Final = b'{"event": "'

Motion = Callable[[float], FloatArray]
"""Pose of the board in C1, shape (4, 4), mm, by the time since it was placed, s."""


@dataclass(frozen=True)
class Placed:
    """A target and since when it stands there.

    Parameters
    ----------
    since_ns
        When it came.
    motion
        Its pose from then on.
    """

    since_ns: Nanoseconds
    motion: Motion


def at_rest(pose: FloatArray) -> Motion:
    """Return the motion of a board that rests at a pose."""
    return lambda _: pose


class World:
    """The truth of a virtual rig.

    Parameters
    ----------
    settings
        Of rig.toml; `settings.virtual` says what is simulated.
    clock
        That all of the rig's devices go by.
    """

    def __init__(self, settings: RigSettings, clock: Clock) -> None:
        self.settings = settings
        self.clock = clock
        self.rig = true_rig(settings)
        self.take_up(settings.virtual.target)
        self._yaw: Callable[[Nanoseconds], float] = lambda _: math.pi / 2
        self._placed: tuple[Placed, ...] = ()
        self._lock = threading.Lock()
        self._truth = settings.virtual.truth and Path(settings.virtual.truth)
        self._start_truth()

    def turn_by(self, yaw: Callable[[Nanoseconds], float]) -> None:
        """Let C2's true yaw, as a reading without error, rad, be what `yaw` says of a moment."""
        self._yaw = yaw

    def take_up(self, target: str) -> None:
        """Let another target stand before the rig from now on; see `VirtualSettings.target`."""
        far = self.rig.depth_range_mm[1]
        self.sheet = sheet(
            target,
            _board(self.settings, self.rig),
            pixel_mm=far / float(self.rig.c1.matrix[0, 0]),
        )
        self.board = self.sheet.board

    def place(self, pose: FloatArray) -> None:
        """Put the board at rest at a pose in C1, shape (4, 4), mm, from now on."""
        self.follow(at_rest(pose))

    def follow(self, motion: Motion, *, since_ns: Nanoseconds | None = None) -> None:
        """Let the board move, from now or a moment to come on."""
        since = self.clock.now_ns() if since_ns is None else since_ns
        with self._lock:
            self._placed = (*self._placed[-64:], Placed(since, motion))
        point = target_in_c1(self.board, motion(0.0)[None])[0]
        self.note("target", t_ns=since, xyz_mm=point.tolist(), pose=motion(0.0).tolist())

    def remove(self) -> None:
        """Take the board away, far behind C1."""
        away = np.eye(4)
        away[2, 3] = -1e6
        self.place(away)

    def pose(self, moment: Nanoseconds) -> FloatArray | None:
        """Return the board's true pose in C1, shape (4, 4), mm; None before there was one."""
        for placed in reversed(self._placed):
            if placed.since_ns <= moment:
                return placed.motion((moment - placed.since_ns) / 1e9)
        return None

    def target(self, moment: Nanoseconds) -> FloatArray:
        """Return where the target truly is, C1's frame, mm, shape (3,)."""
        pose = self.pose(moment)
        if pose is None:
            return np.full(3, np.nan)
        point: FloatArray = target_in_c1(self.board, pose[None])[0]
        return point

    def yaw(self, moment: Nanoseconds) -> float:
        """Return C2's true yaw, as a reading without error, rad."""
        return self._yaw(moment)

    def seen(self, camera: CameraName, moment: Nanoseconds) -> FloatArray | None:
        """Return the board's pose in a camera, shape (4, 4), mm."""
        pose = self.pose(moment)
        if pose is None or camera == "c1":
            return pose
        stands = c2_pose(self.rig, np.array([self.yaw(moment)]))
        in_c2: FloatArray = invert(stands)[0] @ pose
        return in_c2

    def picture(
        self,
        camera: CameraName,
        begin_ns: Nanoseconds,
        exposure_ns: Nanoseconds,
        rng: np.random.Generator,
    ) -> Image:
        """Return the picture of an exposure, with the blur of whatever moves meanwhile."""
        ends = [self.seen(camera, begin_ns + k * exposure_ns // 2) for k in range(3)]
        poses = [_out_of_sight() if pose is None else pose for pose in ends]
        count = self._blurred(camera, poses)
        if count > 1:
            moments = (begin_ns + (2 * k + 1) * exposure_ns // (2 * count) for k in range(count))
            between = [self.seen(camera, moment) for moment in moments]
            poses = [_out_of_sight() if pose is None else pose for pose in between]
        return expose(self.imagers[camera], self.sheet.pattern, np.array(poses[:count]), rng)

    def _blurred(self, camera: CameraName, poses: list[FloatArray]) -> int:
        """Return of how many pictures an exposure is to be the mean."""
        points = np.array([target_in_c1(self.board, pose[None])[0] for pose in poses])
        if np.ptp(points, axis=0).max() < 1e-9:
            return 1
        lens = self.imagers[camera].camera
        rays = points[:, :2] / np.maximum(np.abs(points[:, 2:]), 1.0)
        way = float(np.abs(np.diff(rays, axis=0)).sum(axis=0).max() * lens.matrix[0, 0])
        return int(np.clip(math.ceil(way / BLUR_STEP_PX), 3, BLUR_MOST))

    @cached_property
    def imagers(self) -> dict[str, Imager]:
        """The cameras with the rays of their pixels."""
        virtual = self.settings.virtual
        optics = Optics(exposure=WHITE_GREY * virtual.light, noise=virtual.grey_noise)
        cameras = {"c1": self.rig.c1, "c2": self.rig.c2}
        return {
            name: prepare(camera, optics, spacing_px=RAY_SPACING_PX)
            for name, camera in cameras.items()
        }

    def note(self, event: str, **truth: Any) -> None:
        """Write one line of the truth, if it is asked for."""
        if self._truth:
            with self._lock, self._truth.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"event": event, **truth}) + "\n")

    def _start_truth(self) -> None:
        if not self._truth:
            return
        _refuse_foreign(self._truth)
        rig = self.rig
        cameras = {
            name: {k: v for k, v in camera_section(camera).items() if k != "image_size"}
            for name, camera in (("c1", rig.c1), ("c2", rig.c2))
        }
        self.note(
            "rig",
            serial=self.settings.serial,
            parameters=dict(zip(NAMES, rig.theta.tolist(), strict=True)),
            cameras=cameras,
            height_mm=rig.height_mm,
            pitch_rad=rig.pitch_rad,
        )


def _refuse_foreign(truth: Path) -> None:
    """Refuse to write the truth to the end of a file that is something else.

    Raises
    ------
    UsageError
        If it is, or cannot be written.
    """
    where = "rig.toml, [virtual] truth"
    try:
        with truth.open("ab+") as file:
            file.seek(0)
            begins = file.read(len(TRUTH_BEGINS))
    except OSError as error:
        raise UsageError(f"{where}: {truth} cannot be written ({error.strerror})") from None
    if begins and begins != TRUTH_BEGINS:
        raise UsageError(f"{where}: {truth} is there and no file of truths; name another")


def _out_of_sight() -> FloatArray:
    pose = np.eye(4)
    pose[2, 3] = -1e6
    return pose


def true_rig(settings: RigSettings) -> TrueRig:
    """Return the rig that the settings simulate.

    It is drawn by `calib.simulate.rig.draw_rig` from `settings.virtual.seed`; a negative
    `baseline_mm` makes it the mirror image, C2 on the left. A lens in rig.toml is the true one.
    """
    virtual, axis = settings.virtual, settings.axis
    is_left = virtual.parameters.get("baseline_mm", 1.0) < 0
    fixed = {
        name: value * float(SIGN[INDEX[name]]) if is_left else value
        for name, value in virtual.parameters.items()
    }
    rng, lenses = np.random.default_rng(virtual.seed).spawn(2)
    sections = settings.cameras
    size = sections.c1.image_size or DEFAULT_SIZE
    rig = draw_rig(rng, model=virtual.model, fixed=fixed, image_size=size, noise=Noise(0.0))
    size2 = sections.c2.image_size or DEFAULT_SIZE
    if size2 != size:
        rig = replace(rig, c2=draw_camera(lenses, image_size=size2))
    if is_left:
        rig = mirror_rig(rig)
    low, high = axis.range_deg
    return replace(
        rig,
        c1=_given(sections.c1, rig.c1),
        c2=_given(sections.c2, rig.c2),
        resolution_rad=math.radians(axis.resolution_deg),
        yaw_range_rad=(math.radians(low), math.radians(high)),
    )


def _given(section: CameraSection, drawn: Camera) -> Camera:
    return stated_camera(section, drawn.image_size) or drawn


def _board(settings: RigSettings, rig: TrueRig) -> Board:
    """Return the board of the settings, or a 9 x 7 chessboard that suits the depths."""
    given = settings.board
    if given is None:
        return fitting_board(rig, near_mm=rig.depth_range_mm[0])
    return board_of(given)
