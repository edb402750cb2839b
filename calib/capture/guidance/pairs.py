"""Guide of stereo pairs: the next one is that which leaves triangulated depth least uncertain.

Shared unknowns are those of the chain's joint solve: both lenses, each with what its own pictures
say of it, the pose of C2 as it is held, the board's warp.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from calib.capture.guidance.asked import AskedPose, Role, asked_for
from calib.capture.guidance.lens import WARP_STD_MM
from calib.capture.guidance.need import Need
from calib.capture.guidance.poses import (
    TILTS_DEG,
    back,
    moved,
    placed,
    repeats,
    rim,
    seen_whole,
    thinned,
    turns,
)
from calib.capture.guidance.solving import (
    NormalPrior,
    PictureKnowledge,
    added_by,
    left_by,
    nothing_known,
    solve,
)
from calib.capture.shutter import WORTH, Shutter, View
from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board
from calib.geometry.camera import Camera, intrinsic_vector, normalise, project, project_points
from calib.geometry.poses import pose_matrix, pose_vector, rotation
from calib.images.joint.model import WARP, BoardImages, JointProblem
from calib.images.pairs import MIN_PAIRS, half_turn_looks_same, single_view_pose

TURN_STD_RAD, SHIFT_STD_SHARE = 0.1, 0.25
"""Of the pose of C2 by tape measure: a yaw axis set by eye, a baseline in parts of it."""

SPACING_MIN_PX: Final = 9.0
"""Spacing of corners in the farther picture; below, detectors err by more than their noise."""

PLACES: Final = (5, 4)
"""Places across and down C1's picture where a board may be, and depths are asked for."""

DEPTHS: Final = 3

ROLES: Final[tuple[Role, Role]] = ("c1", "c2")


@dataclass(frozen=True)
class LensSays:
    """What a lens' own pictures say.

    Parameters
    ----------
    camera
        The estimate.
    information
        Of its intrinsics and the board's warp, shape (p + 2, p + 2); None where the lens is given
        and not to be solved.
    """

    camera: Camera
    information: FloatArray | None


class PairGuide:
    """Chooses the next pose for both cameras' pictures of one board.

    Parameters
    ----------
    board
        The board.
    lenses
        Of C1 and C2.
    pose_12
        Pose of C2 in C1 by tape measure, rad and mm, shape (6,).
    need
        Tolerance and depths.
    """

    unit: Final = "%"
    noun: Final = "pair"

    def __init__(
        self, board: Board, lenses: tuple[LensSays, LensSays], pose_12: FloatArray, need: Need
    ) -> None:
        self.board = board
        self._points = board.object_points()
        self._thin = thinned(board)
        self._need = need
        self._pixels = np.zeros((0, 2, board.corner_count, 2))
        self._refused = np.zeros((0, board.corner_count, 2))
        self._shutters = {"c1": Shutter(board), "c2": Shutter(board)}
        self._cameras = lenses[0].camera, lenses[1].camera
        self._free = lenses[0].information is not None, lenses[1].information is not None
        empty = self._problem(self._pixels, self._points)
        self._prior = _prior(empty, lenses, pose_12)
        self._take(nothing_known(empty, self._prior))

    @property
    def count(self) -> int:
        """Pairs so far."""
        return len(self._pixels)

    @property
    def needed(self) -> float:
        """Standard uncertainty of depth that is to be reached, in per cent of it."""
        return 100 * self._need.pairs_share

    @property
    def is_done(self) -> bool:
        """Whether depths by pairs are known well enough, and the chain will take them."""
        return self.count >= MIN_PAIRS and self.u <= self.needed

    def add(self, *pairs: FloatArray) -> None:
        """Take pairs into account, their corners px, shape (2, corners, 2) each.

        Raises
        ------
        EstimationError
            If they contradict the others so much that there is no solution; they are left out.
        """
        if not pairs:
            return
        known, pixels = self.known, self._pixels
        own = known.at.own
        for pair in pairs:
            upright, pose = self._as_c1_reads(pair)
            pixels = np.concatenate([pixels, upright[None]])
            own = np.concatenate([own, pose[None]])
        problem = self._problem(pixels, self._points)
        start = known.at._replace(own=own)
        if not len(known.at.own):
            start = start._replace(shared=self._first(pixels[0]))
        self._take(solve(problem, start, self._prior))
        self._pixels = pixels

    def take(self, views: Mapping[Role, View]) -> None:
        """Take a pair into account; errors as of `add`."""
        self.add(np.stack([views["c1"].corners, views["c2"].corners]))

    def ask(self) -> AskedPose:
        """Return the pose to hold the board at next.

        Raises
        ------
        EstimationError
            If there is no place where both cameras see all of the board.
        """
        poses = self._candidates()
        if not len(poses):
            raise EstimationError(
                "there is no place between the depths asked for where both cameras see the whole "
                "board; use a smaller board, or other --depths"
            )
        shown = self._shown(poses)
        variance = self._variance(self._added(poses, shown))
        done = np.concatenate([self._pixels[:, 0], self._refused])
        fresh = ~repeats(shown[:, 0], done, self.board)
        best = int(np.argmin(np.where(fresh | ~fresh.any(), variance, np.inf)))
        self._gain = self.u**2 - float(variance[best])
        self._asked_px = shown[best, 0]
        for shutter in self._shutters.values():
            shutter.start()
        return asked_for(
            "c1", self._camera(0), self.board, poses[best],
            u=(self.u, float(np.sqrt(variance[best]))), needed=self.needed,
            unit=f"% of depth, {_distance(poses[best], self.board):.0f} mm away",
            taken=self._pixels[:, 0],
        )  # fmt: skip

    def refuse(self) -> None:
        """Never ask again for the pose asked for last."""
        self._refused = np.concatenate([self._refused, self._asked_px[None]])

    def fault(self, views: Mapping[Role, View]) -> str:
        """Return why no pair is to be taken yet; "" if it is to be."""
        faults = [
            self._shutters[role].fault(views[role], self._pixels[:0, i])
            for i, role in enumerate(ROLES)
        ]
        for role, found in zip(("C1", "C2"), faults, strict=True):
            if found:
                return f"{role}: {found}"
        if repeats(views["c1"].corners[None], self._pixels[:, 0], self.board)[0]:
            return "nearly the same as a pair taken"
        if self._worth(np.stack([views["c1"].corners, views["c2"].corners])) < WORTH:
            return "it brings too little: fill the outline"
        return ""

    def _worth(self, pair: FloatArray) -> float:
        if self._gain <= 0:
            return 1.0
        upright, pose = self._as_c1_reads(pair)
        after = self._variance(self._added(pose[None], upright[None]))[0]
        return float((self.u**2 - after) / self._gain)

    def _take(self, known: PictureKnowledge) -> None:
        self.known = known
        self._factor = known.factor(known.problem.at_pose)
        self._asked = self._asked_of()
        nothing = np.zeros((1, *known.information.shape))
        self.u = float(np.sqrt(self._variance(nothing)[0]))

    def _variance(self, added: FloatArray) -> FloatArray:
        """Return the variance of depth, per cent squared, with more information, (v, n, n)."""
        result: FloatArray = 1e4 * left_by(self.known, added, self._asked) * self._factor
        return result

    def _camera(self, which: int) -> Camera:
        return self.known.problem.camera_at(self.known.at.shared, which)

    @property
    def _pose_12(self) -> FloatArray:
        return self.known.at.shared[self.known.problem.at_pose]

    def _candidates(self) -> FloatArray:
        """Return poses in C1 at which both cameras see the whole board, shape (n, 6)."""
        c1, c2 = self._camera(0), self._camera(1)
        every = turns()
        tilt = np.degrees(np.linalg.norm(every, axis=1))
        tilted = every[(tilt < 1) | (tilt > TILTS_DEG[-1] - 1)]
        middle = rim(self.board).mean(axis=0)
        rays = _rays(c1, 0.12)
        depths = _depths(self._need)
        shift = np.concatenate([z * rays for z in depths])
        vectors = np.repeat(tilted, len(shift), axis=0)
        arms = np.array([rotation(v) @ middle for v in tilted])
        at = np.tile(shift, (len(tilted), 1)) - np.repeat(arms, len(shift), axis=0)
        poses = np.concatenate([vectors, at], axis=1)
        poses = poses[seen_whole(c1, self.board, poses)]
        in_c2 = moved(back(self._pose_12), poses)
        poses = poses[seen_whole(c2, self.board, in_c2)]
        if not len(poses):
            return poses
        shown = self._shown(poses)
        across = np.linalg.norm(shown[:, :, 1] - shown[:, :, 0], axis=-1).min(axis=1)
        down = np.linalg.norm(shown[:, :, self.board.columns] - shown[:, :, 0], axis=-1).min(axis=1)
        large: FloatArray = poses[np.minimum(across, down) > SPACING_MIN_PX]
        return large

    def _shown(self, poses: FloatArray) -> FloatArray:
        """Return where both cameras see the corners, px, shape (n, 2, corners, 2)."""
        in_c2 = moved(back(self._pose_12), poses)
        both = [
            project(self._camera(i), placed(p, self._points).reshape(-1, 3)).reshape(
                len(poses), -1, 2
            )
            for i, p in enumerate((poses, in_c2))
        ]
        return np.stack(both, axis=1)

    def _added(self, poses: FloatArray, shown: FloatArray) -> FloatArray:
        few = self._problem(shown[:, :, self._thin], self._points[self._thin])
        return added_by(self.known, few, poses) * (len(self._points) / len(self._thin))

    def _problem(self, pixels: FloatArray, points: FloatArray) -> JointProblem:
        """Return the problem of pairs, px, shape (v, 2, corners, 2)."""
        count = len(pixels)
        images = BoardImages(
            names=("",) * (2 * count),
            kinds=("pair",) * (2 * count),
            camera=np.tile(np.array([0, 1], dtype=np.int64), count),
            view=np.repeat(np.arange(count), 2),
            in_pair=np.tile(np.array([False, True]), count),
            pixels=pixels.reshape(2 * count, len(points), 2),
        )
        return JointProblem(images, points, self._cameras, self._free)

    def _as_c1_reads(self, pair: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a pair with C2's corners in the order of C1's, and the board's pose in C1.

        Of the two ends from which C2 may have read the board, that which suits the pose of C2.
        """
        pose, _ = single_view_pose(self._camera(0), points=self._points, pixels=pair[0])
        ends = [pair[1], pair[1][::-1]] if half_turn_looks_same(self.board) else [pair[1]]
        expected = self._shown(pose[None])[0, 1]
        off = [float(np.nanmedian(np.linalg.norm(end - expected, axis=-1))) for end in ends]
        return np.stack([pair[0], ends[int(np.argmin(off))]]), pose

    def _first(self, pair: FloatArray) -> FloatArray:
        """Return shared unknowns by the poses of one pair."""
        poses = [
            pose_matrix(single_view_pose(self._camera(i), points=self._points, pixels=pair[i])[0])
            for i in (0, 1)
        ]
        shared = self.known.at.shared.copy()
        shared[self.known.problem.at_pose] = pose_vector(poses[0] @ np.linalg.inv(poses[1]))
        return shared

    def _asked_of(self) -> FloatArray:
        """Return derivatives of triangulated depths, in parts of them, shape (m, n)."""
        problem, shared = self.known.problem, self.known.at.shared
        c1, c2 = self._camera(0), self._camera(1)
        rays = _rays(c1, 0.1)
        near, far = self._need.depths_mm
        points = np.concatenate([z * rays for z in (near, 2 / (1 / near + 1 / far), far)])
        pose = shared[problem.at_pose]
        turn, slope = cv2.Rodrigues(-pose[:3])
        arms = points - pose[3:]
        in_c2 = arms @ turn.T
        pixels = project(c2, in_c2)
        seen = ((pixels > 0) & (pixels < np.array(c2.image_size) - 1)).all(axis=1)
        if not seen.any():
            seen = in_c2[:, 2] > 0
        points, arms, in_c2 = points[seen], arms[seen], in_c2[seen]
        one, two = project_points(c1, points), project_points(c2, in_c2)
        by_point = np.concatenate([one.by_point, two.by_point @ turn], axis=1)
        by_shared = np.zeros((len(points), 4, problem.size))
        if problem.free[0]:
            by_shared[:, :2, problem.at_lens(0)] = one.by_intrinsics
        if problem.free[1]:
            by_shared[:, 2:, problem.at_lens(1)] = two.by_intrinsics
        by_turn = -np.einsum("jab,nb->naj", slope.reshape(3, 3, 3), arms)
        by_shared[:, 2:, problem.at_pose[:3]] = two.by_point @ by_turn
        by_shared[:, 2:, problem.at_pose[3:]] = -two.by_point @ turn
        moved = -np.linalg.pinv(by_point) @ by_shared
        asked: FloatArray = moved[:, 2] / points[:, 2:]
        return asked


def lens_says(known: PictureKnowledge) -> LensSays:
    """Return what a lens' own pictures say, of a guide's `known`; its poses eliminated."""
    problem = known.problem
    lens = problem.at_lens(0)
    kept = np.concatenate([lens, problem.at_warp])
    factor = known.factor(lens)
    information = known.normals.sum(axis=0)[np.ix_(kept, kept)] / factor
    return LensSays(problem.camera_at(known.at.shared, 0), information)


def by_tape(baseline_mm: float, reading_rad: float) -> FloatArray:
    """Return the pose of C2 in C1 by a tape measure and a reading, rad and mm, shape (6,).

    Parameters
    ----------
    baseline_mm
        Of C2's yaw axis at +X of C1; negative at -X.
    reading_rad
        At 90 degrees C2 looks parallel to C1, below towards -X.
    """
    return np.array([0.0, reading_rad - np.pi / 2, 0.0, baseline_mm, 0.0, 0.0])


def holding_reading(need: Need, baseline_mm: float) -> float:
    """Return the reading at which C2 looks at the middle of the depths, rad."""
    near, far = need.depths_mm
    return float(np.pi / 2 - np.arctan(baseline_mm / 2 / (2 / (1 / near + 1 / far))))


def _prior(
    problem: JointProblem, lenses: tuple[LensSays, LensSays], pose_12: FloatArray
) -> NormalPrior:
    free = [intrinsic_vector(lens.camera) for lens in lenses if lens.information is not None]
    mean = np.concatenate([*free, pose_12, np.zeros(WARP)])
    precision = np.zeros((problem.size, problem.size))
    for i, lens in enumerate(lenses):
        if lens.information is not None:
            places = np.concatenate([problem.at_lens(i), problem.at_warp])
            precision[np.ix_(places, places)] += lens.information
    shift = SHIFT_STD_SHARE * max(abs(float(pose_12[3])), 1.0)
    std = np.concatenate([np.full(3, TURN_STD_RAD), np.full(3, shift)])
    precision[problem.at_pose, problem.at_pose] += std**-2.0
    precision[problem.at_warp, problem.at_warp] += WARP_STD_MM**-2.0
    return NormalPrior(mean, precision)


def _depths(need: Need) -> FloatArray:
    """Return depths of boards, mm, evenly in their inverses."""
    near, far = need.depths_mm
    depths: FloatArray = 1 / np.linspace(1 / near, 1 / far, DEPTHS)
    return depths


def _rays(camera: Camera, room: float) -> FloatArray:
    """Return rays over a picture but for a rim, in parts of its size, shape (n, 3)."""
    u, v = (
        np.linspace(room * (side - 1), (1 - room) * (side - 1), count)
        for side, count in zip(camera.image_size, PLACES, strict=True)
    )
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    xy = normalise(camera, grid, strict=False)
    xy = xy[np.isfinite(xy).all(axis=1)]
    return np.concatenate([xy, np.ones((len(xy), 1))], axis=1)


def _distance(pose: FloatArray, board: Board) -> float:
    return float((rotation(pose[:3]) @ rim(board).mean(axis=0) + pose[3:])[2])
