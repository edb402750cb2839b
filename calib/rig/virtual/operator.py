"""The hand that puts targets before the virtual rig.

    operator = Operator(rig.world)
    operator.show_gaze()                   # the next board, at rest, seen by both cameras
    depth, u = operator.ruler_mm()         # what an operator with a ruler would write down

A board stands in the order of a low-discrepancy sequence over the working depths, so that any
number of them covers the range. With the fault `moving_share` some are moved soon after.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from calib.core.arrays import FloatArray
from calib.core.errors import UsageError
from calib.geometry.camera import project
from calib.rig.virtual.world import CameraName, World
from calib.simulate.rig import c2_pose
from calib.simulate.scene import (
    IntrinsicViews,
    Placement,
    SweepPlan,
    draw_gaze_poses,
    draw_intrinsic_views,
    draw_sweep,
    held_reading,
)

SLICES: Final = 16
"""Depth slices that a target may stand in."""

RULER_U_MM: Final = 0.5
"""Standard uncertainty of a depth measured by hand."""

MOVED_WITHIN_S: Final = (0.05, 1.0)
MOVED_BY_MM: Final = (3.0, 40.0)
"""When and how far a target is moved by the fault `moving_share`."""

PLATE_TRIES: Final = 20_000
PLATE_TURN_DEG: Final = np.array([65.0, 12.0, 8.0])
PLATE_MARGIN, PLATE_EDGE = 0.06, 0.3
"""Shares of the picture: rim kept free by a plate's corners, least length of its upright edges."""


class Operator:
    """Places boards before a virtual rig, drawn from the seed of its settings.

    Parameters
    ----------
    world
        Of `calib.rig.devices.RigDevices`.
    held_rad
        Reading at which C2 must see the board too, rad, for stereo pairs; None if there are none.
    """

    def __init__(self, world: World, *, held_rad: float | None = None) -> None:
        self._world = world
        self._held = held_rad
        streams = np.random.default_rng([world.settings.virtual.seed, 9]).spawn(4)
        self._gazes, self._views, self._faults, self._ruler = streams
        self._order = _van_der_corput()

    @property
    def middle_reading_rad(self) -> float:
        """Reading, whole counts, at which C2 sees the middle of the working depths, rad."""
        return held_reading(self._world.rig, self._world.rig.depth_range_mm)

    def show_gaze(self, depth_range_mm: tuple[float, float] | None = None) -> FloatArray:
        """Put the board at the next place where both cameras see all of it; return its pose."""
        near, far = depth_range_mm or self._world.rig.depth_range_mm
        place = next(self._order) * SLICES
        low = near + (far - near) * int(place) / SLICES
        poses = draw_gaze_poses(
            self._world.rig,
            self._world.board,
            self._gazes,
            count=1,
            depth_range_mm=(low, low + (far - near) / SLICES),
            held=self._held,
        )
        self.put(poses[0])
        pose: FloatArray = poses[0]
        return pose

    def show_plate(self, depth_range_mm: tuple[float, float] | None = None) -> None:
        """Put the plate up so that C1 sees both its upper corners, at different depths.

        Raises
        ------
        UsageError
            If there is none, or there is no such place within the working depths.
        """
        near, far = depth_range_mm or self._world.rig.depth_range_mm
        corners = self._world.sheet.corners_mm
        if not corners:
            raise UsageError("no plate stands before the rig: [virtual] target in rig.toml")
        ends = np.stack([corners["left-upper"], corners["right-upper"], corners["left-lower"]])
        length, height = (float(np.hypot(*(ends[0] - ends[k])[:2])) for k in (1, 2))
        for _ in range(PLATE_TRIES):
            turn, tilt, roll = self._gazes.uniform(-1, 1, 3) * PLATE_TURN_DEG
            pose = np.eye(4)
            pose[:3, :3] = Rotation.from_euler("yxz", [turn, tilt, roll], degrees=True).as_matrix()
            middle = self._gazes.uniform([-0.3, -0.3, 1], [0.3, 0.15, 1])
            middle *= self._gazes.uniform(near, far)
            pose[:3, 3] = middle - pose[:3, :3] @ ends[:2].mean(axis=0)
            if self._shows_plate(ends[:2] @ pose[:3, :3].T + pose[:3, 3], height, (near, far)):
                self.put(pose)
                return
        raise UsageError(
            f"a plate of {length:g} mm has no place between {near:.0f} and {far:.0f} mm where C1 "
            "sees both its ends"
        )

    def _shows_plate(
        self, ends: FloatArray, height_mm: float, depth_range_mm: tuple[float, float]
    ) -> bool:
        """Return whether C1 sees both ends well, and they are within the depths."""
        lens = self._world.rig.c1
        near, far = depth_range_mm
        if ends[:, 2].min() < near or ends[:, 2].max() > far:
            return False
        size = np.array(lens.image_size)
        pixels = project(lens, ends)
        upright = np.minimum(
            size[1] - pixels[:, 1], height_mm * lens.matrix[1, 1] / ends[:, 2]
        ) / size[1]  # fmt: skip
        margin = PLATE_MARGIN * size
        inside = ((pixels > margin) & (pixels < size - margin)).all()
        return bool(inside and upright.min() > PLATE_EDGE)

    def put(self, pose: FloatArray) -> None:
        """Put the board at a pose in C1, shape (4, 4), mm; it may not stay there."""
        self._world.place(pose)
        if self._faults.random() < self._world.settings.virtual.moving_share:
            self._move(pose)

    def put_before_c2(self, pose: FloatArray) -> None:
        """Put the board at a pose in C2 as C2 stands now, shape (4, 4), mm."""
        stands = c2_pose(self._world.rig, np.array([self._world.yaw(self._world.clock.now_ns())]))
        self.put(stands[0] @ pose)

    def show_views(self, camera: CameraName, views: int) -> Iterator[None]:
        """Show a camera so many views of the board for its intrinsics, one a step."""
        lens = self._world.rig.c1 if camera == "c1" else self._world.rig.c2
        plan = IntrinsicViews(count=views)
        put = self.put if camera == "c1" else self.put_before_c2
        for pose in draw_intrinsic_views(lens, self._world.board, self._views, plan):
            put(pose)
            yield

    def show_sweep(self, plan: SweepPlan) -> Iterator[Placement]:
        """Put the board up for each placement of a yaw sweep; yield it with its readings."""
        for placement in draw_sweep(self._world.rig, self._world.board, self._views, plan):
            self.put(placement.pose)
            yield placement

    def ruler_mm(self) -> tuple[float, float]:
        """Measure the target's depth by hand: value and standard uncertainty, mm."""
        depth = float(self._world.target(self._world.clock.now_ns())[2])
        return depth + RULER_U_MM * float(self._ruler.standard_normal()), RULER_U_MM

    def _move(self, pose: FloatArray) -> None:
        moved = pose.copy()
        away = self._faults.standard_normal(3)
        away *= self._faults.uniform(*MOVED_BY_MM) / np.linalg.norm(away)
        moved[:3, 3] += away
        when = self._world.clock.now_ns() + round(self._faults.uniform(*MOVED_WITHIN_S) * 1e9)
        self._world.follow(lambda _: moved, since_ns=when)


def _van_der_corput() -> Iterator[float]:
    """Yield the base-2 sequence 1/2, 1/4, 3/4, 1/8, ..."""
    for number in count(1):
        digits = f"{number:b}"
        yield sum(int(d) / 2 ** (k + 1) for k, d in enumerate(reversed(digits)))
