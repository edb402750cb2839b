"""Where boards stand and where C2 looks: poses of a calibration session, drawn at random.

Every pose returned shows the whole board to the cameras that must see it. All poses are rigid
transforms, shape (4, 4), mm, of the board's frame (origin at the first inner corner, Z away from
the viewer) into the frame named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import UsageError
from calib.geometry.board import Board
from calib.geometry.camera import Camera, normalise, project, radius_limit
from calib.geometry.plane import gaze_at
from calib.simulate.rig import TrueRig, c2_pose

WIDE_USED = 0.7
"""Share of a wide lens's picture in which targets stand: C2 does not turn to the rest."""

LEGIBLE_PX = 6.0
"""Side of a square below which a board by a wide lens is not found for sure."""

EDGE_PX = 12.0
"""Squares keep this far from the image's edge; detectors want some white around them."""

NEAR_FILL = 0.45
"""Width of the board in C1's image at the near end of the working depths, of the image's width."""

COVERAGE_CELLS = (8, 6)
"""Cells of the imager, across and down, in which intrinsic views look for new corners."""

CANDIDATES_PER_VIEW = 12
"""Visible poses drawn for each intrinsic view taken."""

GAZE_TILT_DEG = (5.0, 30.0)
SWEEP_TILT_DEG = (15.0, 30.0)
"""Tilts of the board; a sweep's pose is the better known the more the board is tilted."""

SWEEP_FILL = 0.35
"""Width of the sweep's board in C2's image: small enough to travel across it."""

SWEEP_YAW_DEG = 18.0
"""The placements' middle readings spread by so much to either side of 90 degrees."""

_SWEEP_STEP_RAD = float(np.deg2rad(0.25))
"""Fineness to which the ends of a sweep are found."""

_TRIES = 4000
"""Poses tried at least; where the board fits at all, one in a hundred does or more."""

_TRIES_PER_POSE = 100


@dataclass(frozen=True)
class IntrinsicViews:
    """How a camera is shown the board for its intrinsics.

    Parameters
    ----------
    count
        Number of images.
    tilt_deg
        Least and largest angle between board and imager; (0, 0) holds all boards parallel to it.
    one_place
        All views from nearly one pose. This and parallel boards are negative controls.
    """

    count: int = 20
    tilt_deg: tuple[float, float] = (10.0, 40.0)
    one_place: bool = False


@dataclass(frozen=True)
class SweepPlan:
    """A yaw sweep.

    Parameters
    ----------
    placements
        Times the board is put up; 0 for no sweep.
    images
        Images a placement.
    half_range_deg
        Largest turn to either side; None for as far as the board stays in view.
    """

    placements: int = 2
    images: int = 12
    half_range_deg: float | None = None


@dataclass(frozen=True)
class Placement:
    """A board at rest before the sweeping C2.

    Parameters
    ----------
    pose
        Board in C1, shape (4, 4).
    readings
        Encoder readings of the images, whole counts, rad, shape (images,).
    """

    pose: FloatArray
    readings: FloatArray


def fitting_board(rig: TrueRig, *, near_mm: float, columns: int = 9, rows: int = 7) -> Board:
    """Return a chessboard that fills a good part of C1's image at the nearest depth, mm."""
    # Of a wide C1 the board must still fit into C2's picture.
    camera = rig.c1 if rig.c1.projection == "perspective" else rig.c2
    width = near_mm * camera.image_size[0] / float(camera.matrix[0, 0])
    square = max(5.0, float(np.round(NEAR_FILL * width / (columns + 1))))
    return Board("chessboard", columns, rows, square, (columns // 2, rows // 2))


def invert(pose: FloatArray) -> FloatArray:
    """Return the inverse of rigid transforms, shape (..., 4, 4)."""
    inverse = np.zeros_like(pose)
    back = pose[..., :3, :3].swapaxes(-1, -2)
    inverse[..., :3, :3] = back
    inverse[..., :3, 3] = -(back @ pose[..., :3, 3, None])[..., 0]
    inverse[..., 3, 3] = 1
    return inverse


def target_in_c1(board: Board, poses: FloatArray) -> FloatArray:
    """Return the gazed corners, mm, shape (n, 3), of boards at `poses`, shape (n, 4, 4)."""
    corner = board.object_points()[board.target_index]
    return np.asarray(poses[:, :3, :3] @ corner + poses[:, :3, 3])


def whole_board_seen(camera: Camera, board: Board, poses: FloatArray) -> BoolArray:
    """Return at which poses, camera from board, shape (n, 4, 4), all squares are in the image."""
    columns, rows = (
        board.square_mm * np.arange(-1.0, count + 1) for count in (board.columns, board.rows)
    )
    x, y = np.meshgrid(columns, rows)
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    seen = points @ poses[:, :3, :3].swapaxes(-1, -2) + poses[:, None, :3, 3]
    in_front = (seen[..., 2] > 0).all(axis=1)
    depth = np.where(seen[..., 2] > 0, seen[..., 2], 1.0)
    rays = seen[..., :2] / depth[..., None]
    unfolded = (np.hypot(rays[..., 0], rays[..., 1]) < radius_limit(camera)).all(axis=1)
    pixels = project(camera, rays.reshape(-1, 2)).reshape(rays.shape)
    last = np.array(camera.image_size) - 1
    inside = ((pixels > EDGE_PX) & (pixels < last - EDGE_PX)).all(axis=(1, 2))
    return np.asarray(in_front & unfolded & inside)


def draw_intrinsic_views(
    camera: Camera, board: Board, rng: np.random.Generator, plan: IntrinsicViews
) -> FloatArray:
    """Draw board poses for a camera's intrinsics, camera from board, shape (count, 4, 4).

    Among random poses in view those are taken, one by one, whose corners reach most parts of the
    imager not reached before.

    Raises
    ------
    UsageError
        If the board does not fit into the image.
    """
    wanted = 1 if plan.one_place else CANDIDATES_PER_VIEW * plan.count
    candidates: list[FloatArray] = []
    drawn = _tried(lambda: _intrinsic_candidate(camera, board, rng, plan.tilt_deg), wanted)
    for pose in drawn:
        if whole_board_seen(camera, board, pose[None])[0]:
            candidates.append(pose)
            if len(candidates) == wanted:
                break
    else:
        raise UsageError("the board hardly fits into the image; ask for smaller squares")
    if plan.one_place:
        return _shaken(candidates[0], rng, count=plan.count, by_mm=0.05 * board.square_mm)
    return _best_spread(camera, board, np.array(candidates), count=plan.count)


def _tried(draw: Callable[[], FloatArray], wanted: int = 1) -> Iterator[FloatArray]:
    for _ in range(max(_TRIES, _TRIES_PER_POSE * wanted)):
        yield draw()


def _intrinsic_candidate(
    camera: Camera, board: Board, rng: np.random.Generator, tilt_deg: tuple[float, float]
) -> FloatArray:
    """Draw a pose whose board spans 0.35 to 0.8 of the image, anywhere on the imager."""
    size = np.array(camera.image_size, dtype=float)
    focal, centre = np.diag(camera.matrix)[:2], camera.matrix[:2, 2]
    span = board.square_mm * (board.columns + 1)
    depth = focal[0] * span / (rng.uniform(0.35, 0.8) * size[0])
    pixel = rng.uniform([0, 0], size)
    turn = _turn(rng, tilt_deg=tilt_deg, roll_std_deg=12.0)
    middle = board.square_mm * np.array([board.columns - 1, board.rows - 1, 0]) / 2
    if camera.projection != "perspective":
        ray = np.array([*normalise(camera, pixel[None])[0], 1.0])
        ray /= np.linalg.norm(ray)  # far off the axis a board is seen where it faces the camera
        return _placed(_facing(ray) @ turn, at=depth * ray, point=middle)
    ray = (pixel - centre) / focal
    return _placed(turn, at=depth * np.array([*ray, 1.0]), point=middle)


def _facing(ray: FloatArray) -> FloatArray:
    """Return the rotation about an axis in the image that takes Z to a unit ray, shape (3, 3)."""
    x, y, z = ray
    across = float(np.hypot(x, y))
    angle = np.arctan2(across, z)
    return rotation(angle / max(across, 1e-12) * np.array([-y, x, 0.0]))


def _turn(
    rng: np.random.Generator, *, tilt_deg: tuple[float, float], roll_std_deg: float
) -> FloatArray:
    """Draw a rotation: a roll in the board's plane, then a tilt about any axis in the image."""
    tilt, about = np.deg2rad(rng.uniform(*tilt_deg)), rng.uniform(0, 2 * np.pi)
    return rotation(tilt * np.array([np.cos(about), np.sin(about), 0])) @ rotation(
        np.array([0, 0, np.deg2rad(rng.normal(0, roll_std_deg))])
    )


def rotation(vector: FloatArray) -> FloatArray:
    """Return the rotation about `vector` by its length in rad, shape (3, 3) (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turned: FloatArray = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)
    return turned


def _placed(turn: FloatArray, *, at: FloatArray, point: FloatArray) -> FloatArray:
    """Return the pose with rotation `turn` that carries the board's `point` to `at`."""
    pose = np.eye(4)
    pose[:3, :3] = turn
    pose[:3, 3] = at - turn @ point
    return pose


def _shaken(pose: FloatArray, rng: np.random.Generator, *, count: int, by_mm: float) -> FloatArray:
    """Return copies of a pose, shape (count, 4, 4), moved a little."""
    poses = np.repeat(pose[None], count, axis=0)
    poses[:, :3, 3] += rng.normal(0, by_mm, (count, 3))
    return poses


def _best_spread(camera: Camera, board: Board, candidates: FloatArray, *, count: int) -> FloatArray:
    """Return `count` of the candidates, each reaching most cells that the others left out."""
    points = board.object_points()
    seen = points @ candidates[:, :3, :3].swapaxes(-1, -2) + candidates[:, None, :3, 3]
    pixels = project(camera, seen.reshape(-1, 3)).reshape(len(candidates), -1, 2)
    cells = (pixels / camera.image_size * COVERAGE_CELLS).astype(int)
    flat = cells[..., 1] * COVERAGE_CELLS[0] + cells[..., 0]
    reaches = np.zeros((len(candidates), COVERAGE_CELLS[0] * COVERAGE_CELLS[1]))
    np.put_along_axis(reaches, flat, 1.0, axis=1)
    visits = np.zeros(reaches.shape[1])
    chosen: list[int] = []
    for _ in range(count):
        gain = reaches @ (1.0 / (1 + visits) ** 2)
        gain[chosen] = -1
        best = int(np.argmax(gain))
        chosen.append(best)
        visits += reaches[best]
    return candidates[chosen]


def held_reading(rig: TrueRig, depth_range_mm: tuple[float, float]) -> float:
    """Return the reading, a whole count, rad, at which C2 is held for the stereo reference.

    C2 then looks at the middle of the working depths (harmonic mean) before the rig's middle.
    """
    near, far = depth_range_mm
    middle = np.array([[rig.theta[0] / 2, 0.0, 2 / (1 / near + 1 / far)]])
    return float(to_counts(rig, gaze_at(rig.theta, middle).alpha2)[0])


def to_counts(rig: TrueRig, reading: FloatArray) -> FloatArray:
    """Return readings rounded to whole counts, rad."""
    rounded: FloatArray = np.rint(reading / rig.resolution_rad) * rig.resolution_rad
    return rounded


def draw_gaze_poses(
    rig: TrueRig,
    board: Board,
    rng: np.random.Generator,
    *,
    count: int,
    depth_range_mm: tuple[float, float],
    held: float | None,
) -> FloatArray:
    """Draw boards to be gazed at, C1 from board, shape (count, 4, 4).

    One in each of `count` equal slices of the depth range, anywhere in C1's image. C2 sees the
    whole board when it gazes at it and, if `held` is given (rad), also from there.

    Raises
    ------
    UsageError
        If there is no such place in a slice.
    """
    near, far = depth_range_mm
    edges = np.linspace(near, far, count + 1)
    slices = list(pairwise(edges.tolist()))
    poses = [_gaze_pose(rig, board, rng, slice_mm=part, held=held) for part in slices]
    return np.array(poses).reshape(count, 4, 4)


def _gaze_pose(
    rig: TrueRig,
    board: Board,
    rng: np.random.Generator,
    *,
    slice_mm: tuple[float, float],
    held: float | None,
) -> FloatArray:
    def draw() -> FloatArray:
        z = rng.uniform(*slice_mm)
        pixel = rng.uniform([0, 0], np.array(rig.c1.image_size, dtype=float))
        centre = rig.c1.matrix[:2, 2]
        if rig.c1.projection == "perspective":
            ray = (pixel - centre) / np.diag(rig.c1.matrix)[:2]
        else:
            ray = normalise(rig.c1, centre + WIDE_USED * (pixel - centre)[None])[0]
        turn = _turn(rng, tilt_deg=GAZE_TILT_DEG, roll_std_deg=5.0)
        corner = board.object_points()[board.target_index]
        return _placed(turn, at=z * np.array([*ray, 1.0]), point=corner)

    low, high = rig.yaw_range_rad
    for pose in _tried(draw):
        if not (
            whole_board_seen(rig.c1, board, pose[None])[0] and _is_legible(rig.c1, board, pose)
        ):
            continue
        reading = float(gaze_at(rig.theta, target_in_c1(board, pose[None])).alpha2[0])
        readings = np.array([reading] if held is None else [reading, held])
        seen = whole_board_seen(rig.c2, board, invert(c2_pose(rig, readings)) @ pose)
        if low < reading < high and seen.all():
            return pose
    raise UsageError(
        f"no place between {slice_mm[0]:.0f} and {slice_mm[1]:.0f} mm shows the whole board "
        f"({board.square_mm:g} mm squares) to both cameras; ask for smaller squares, larger depths "
        "or a shorter baseline"
    )


def _is_legible(camera: Camera, board: Board, pose: FloatArray) -> bool:
    """Return whether squares are large enough to be found; those of a pinhole always are."""
    if camera.projection == "perspective":
        return True
    corners = project(camera, board.object_points() @ pose[:3, :3].T + pose[:3, 3])
    grid = corners.reshape(board.rows, board.columns, 2)
    sides = (np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1))
    return bool(min(sides) >= LEGIBLE_PX)


def draw_sweep(
    rig: TrueRig, board: Board, rng: np.random.Generator, plan: SweepPlan
) -> tuple[Placement, ...]:
    """Draw the placements of a yaw sweep.

    Each board stands in the middle of C2's view at a middle reading of its own; C2 turns, in equal
    steps, from where the whole board enters the image to where it leaves it.
    """
    spread = np.linspace(-1, 1, plan.placements) if plan.placements > 1 else np.zeros(1)
    middles = np.deg2rad(90 + SWEEP_YAW_DEG * spread)[: plan.placements]
    return tuple(_placement(rig, board, rng, plan, middle=float(m)) for m in middles)


def _placement(
    rig: TrueRig, board: Board, rng: np.random.Generator, plan: SweepPlan, *, middle: float
) -> Placement:
    span = board.square_mm * (board.columns + 1)
    distance = float(rig.c2.matrix[0, 0]) * span / (SWEEP_FILL * rig.c2.image_size[0])
    corner = board.object_points()[board.target_index]
    turn = _turn(rng, tilt_deg=SWEEP_TILT_DEG, roll_std_deg=5.0)
    in_c2 = _placed(turn, at=np.array([0, 0, distance]), point=corner)
    pose = c2_pose(rig, np.array(middle)) @ in_c2

    limit = np.deg2rad(plan.half_range_deg if plan.half_range_deg is not None else 60.0)
    turns = np.arange(0.0, limit + _SWEEP_STEP_RAD / 2, _SWEEP_STEP_RAD)
    back, forth = (
        _seen_until(rig, board, pose, readings=middle + sign * turns) for sign in (-1.0, 1.0)
    )
    return Placement(pose, to_counts(rig, np.linspace(back, forth, plan.images)))


def _seen_until(rig: TrueRig, board: Board, pose: FloatArray, *, readings: FloatArray) -> float:
    """Return the last reading, rad, up to which C2 sees the whole board all the way."""
    seen = whole_board_seen(rig.c2, board, invert(c2_pose(rig, readings)) @ pose)
    if not seen[0]:
        raise UsageError("the sweep's board does not fit into C2's image; ask for fewer rows")
    return float(readings[-1] if seen.all() else readings[np.argmin(seen) - 1])
