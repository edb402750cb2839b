"""All pictures of a dataset as one problem: each picture once, each board at rest one view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import cv2
import numpy as np
from scipy.optimize import least_squares

from calib.core.arrays import FloatArray
from calib.core.errors import EstimationError
from calib.geometry.board import Board, Corners
from calib.geometry.parameters import ENCODER_CENTRE_RAD, INDEX, PARAMETERS
from calib.geometry.poses import pose_matrix, pose_vector
from calib.images.adjustment.mounting import ENCODER, RIG, pose_of
from calib.images.adjustment.problem import WARP, AdjustmentProblem, BoardPictures
from calib.images.bundle import finite, inverse
from calib.images.detection.grid import orient_like
from calib.images.joint.reduced import Unknowns
from calib.images.mrcal.solves import MIN_CORNERS
from calib.images.pairs import half_turn_looks_same, single_view_pose
from calib.images.stereo.solve import CameraPair

MIN_VIEWS = 3
"""Boards seen by both cameras: the poses of two could agree by chance, that of a third checks."""

ENOUGH_TURN_RAD = float(np.deg2rad(5.0))
"""Turn of C2 below which its pictures do not tell the yaw axis from C2's own place."""

HELD_PX, HELD_COEFFICIENT = 1e-4, 1e-7
"""Standard deviations that hold what is exact of a given lens: a thousandth of corner noise."""

_TURN, _SHIFT = 0.005, 0.01
"""Of single views: error of a direction, rad, and of a shift in parts of the depth."""

_MOUNT_MM = 50.0
"""How far C2's centre is looked for from the yaw axis, where the start has little to tell it."""


@dataclass(frozen=True)
class Rows:
    """Pictures of gaze rows and a yaw sweep: the r readings of C2, and what was seen there.

    Parameters
    ----------
    ids
        Of the rows.
    image_c1, image_c2
        Pictures, None where a row has none.
    readings_rad
        Of the encoder, shape (r,).
    """

    ids: tuple[str, ...] = ()
    image_c1: tuple[str | None, ...] = ()
    image_c2: tuple[str | None, ...] = ()
    readings_rad: FloatArray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Swept:
    """Pictures of C2 in a sweep, with their placement and reading."""

    images: tuple[str, ...] = ()
    placements: tuple[str, ...] = ()
    readings_rad: FloatArray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Taken:
    """All pictures that a calibration may use.

    Parameters
    ----------
    lens
        Pictures for the lenses of C1 and of C2.
    pairs
        Those of stereo pairs, C1's and C2's.
    held_rad
        Reading at which C2 was held for the pairs; None where it is not known.
    rows, sweep
        Those with readings.
    reading_std_rad
        Stated standard uncertainty of a reading.
    priors
        Mean and standard deviation of parameters, by name, in place of the defaults.
    """

    lens: tuple[tuple[str, ...], tuple[str, ...]]
    pairs: tuple[tuple[str, str], ...]
    held_rad: float | None
    rows: Rows
    sweep: Swept
    reading_std_rad: float
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass
class _Collection:
    """Pictures so far, by view."""

    names: list[str] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    camera: list[int] = field(default_factory=list)
    view: list[int] = field(default_factory=list)
    exposure: list[int] = field(default_factory=list)
    pixels: list[FloatArray] = field(default_factory=list)
    readings: list[float] = field(default_factory=list)
    views: int = 0
    known: dict[tuple[int, bytes], int] = field(default_factory=dict)

    def add(
        self, name: str, kind: str, camera: int, view: int, pixels: FloatArray, exposure: int = -1
    ) -> None:
        """Add a picture."""
        self.known[camera, pixels.tobytes()] = view
        self.names.append(name)
        self.kinds.append(kind)
        self.camera.append(camera)
        self.view.append(view)
        self.exposure.append(exposure)
        self.pixels.append(pixels)

    def new_view(self) -> int:
        """Return a view without pictures."""
        self.views += 1
        return self.views - 1

    def at(self, reading: float) -> int:
        """Return a new reading of the encoder."""
        self.readings.append(reading)
        return len(self.readings) - 1

    def add_both(self, kind: str, both: _Both, exposure: int) -> None:
        """Add pictures of one board by C1 and by C2, the latter at a reading."""
        one, two = both.pixels
        view = self.known.get((0, one.tobytes()))
        if view is None:
            view = self.new_view()
            self.add(both.names[0], kind, 0, view, one)
        if (1, two.tobytes()) not in self.known:
            self.add(both.names[1], kind, 1, view, two, exposure)

    def add_alone(self, name: str, kind: str, camera: int, pixels: FloatArray) -> None:
        """Add a picture that stands in no relation to others."""
        if (camera, pixels.tobytes()) not in self.known:
            self.add(name, kind, camera, self.new_view(), pixels)


@dataclass(frozen=True)
class _Both:
    names: tuple[str, str]
    pixels: tuple[FloatArray, FloatArray]


def gather(
    taken: Taken,
    corners: tuple[Corners, Corners],
    board: Board,
    rig: CameraPair,
) -> tuple[AdjustmentProblem, Unknowns]:
    """Return the problem and where to start it.

    A picture named for several purposes, or under several names, counts once: first as part of a
    pair, then of a row, of the sweep, for a lens. A given lens is an unknown, too, within its
    uncertainty.

    Parameters
    ----------
    rig
        Cameras to start from; the pictures for a lens that is not `free` are left out.

    Raises
    ------
    EstimationError
        If too few boards are seen by both cameras, or C2 hardly turned.
    """
    seen = tuple(dict(zip(c.images, c.pixels, strict=True)) for c in corners)
    found = _Collection()
    _add_pairs(found, taken, seen, board)
    _add_rows(found, taken.rows, seen, board)
    _add_sweep(found, taken.sweep, seen[1], board)
    for c in (0, 1):
        for name in taken.lens[c] if rig.free[c] else ():
            if _shown(seen[c], name):
                found.add_alone(name, "lens", c, seen[c][name])
    if not found.names:
        raise EstimationError("adjustment: the board was found in no picture")
    pictures = BoardPictures(
        names=tuple(found.names),
        kinds=tuple(found.kinds),
        camera=np.array(found.camera),
        view=np.array(found.view),
        exposure=np.array(found.exposure),
        pixels=np.array(found.pixels),
        readings_rad=np.array(found.readings),
    )
    _require_turns(pictures)
    known = _known(taken.priors)
    problem = AdjustmentProblem(
        pictures=pictures,
        points=board.object_points(),
        cameras=rig.cameras,
        free=(_uncertain(rig, 0), _uncertain(rig, 1)),
        names=RIG,
        prior=tuple(known[name] for name in RIG),
        reading_std_rad=taken.reading_std_rad,
        lens_information=(_information(rig, 0), _information(rig, 1)),
    )
    mounted, poses = _start(problem)
    return problem, problem.start(mounted, np.zeros(WARP), poses)


def _uncertain(rig: CameraPair, camera: int) -> bool:
    return rig.free[camera] or bool(np.any(rig.covariances[camera]))


def _information(rig: CameraPair, camera: int) -> FloatArray:
    """Return what is known of a lens beforehand: nothing where its pictures are used."""
    covariance = rig.covariances[camera]
    if rig.free[camera]:
        return np.zeros_like(covariance)
    least = np.full(len(covariance), HELD_COEFFICIENT)
    least[:4] = HELD_PX
    return inverse(covariance + np.diag(least**2))


def _known(priors: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Return mean and standard deviation of each unknown of the rig; an infinite one for none."""
    default = {p.name: (0.0, p.prior_std or np.inf) for p in PARAMETERS if p.name in RIG}
    stated = {name: prior for name, prior in priors.items() if name in RIG}
    return dict.fromkeys(RIG, (0.0, np.inf)) | default | stated


def _shown(seen: Mapping[str, FloatArray], name: str | None) -> bool:
    return name is not None and name in seen and int(finite(seen[name]).sum()) >= MIN_CORNERS


def _both(
    names: tuple[str | None, str | None], seen: tuple[Mapping[str, FloatArray], ...], board: Board
) -> _Both | None:
    """Return pictures of one board, C2's corners from the end from which C1's were read."""
    one, two = names
    if one is None or two is None or not (_shown(seen[0], one) and _shown(seen[1], two)):
        return None
    turned = orient_like(seen[0][one][None], seen[1][two][None], board)[0]
    return _Both((one, two), (seen[0][one], turned))


def _add_pairs(
    found: _Collection, taken: Taken, seen: tuple[Mapping[str, FloatArray], ...], board: Board
) -> None:
    held = -1 if taken.held_rad is None or not taken.pairs else found.at(taken.held_rad)
    for names in taken.pairs:
        both = _both(names, seen, board)
        if both is not None and held >= 0:
            found.add_both("pair", both, held)
            continue
        for c in (0, 1):
            if _shown(seen[c], names[c]):
                found.add_alone(names[c], "pair", c, seen[c][names[c]])


def _add_rows(
    found: _Collection, rows: Rows, seen: tuple[Mapping[str, FloatArray], ...], board: Board
) -> None:
    for one, two, reading in zip(rows.image_c1, rows.image_c2, rows.readings_rad, strict=True):
        both = _both((one, two), seen, board)
        if both is not None:
            found.add_both("row", both, found.at(float(reading)))
            continue
        for c, name in enumerate((one, two)):
            if name is not None and _shown(seen[c], name):
                found.add_alone(name, "row", c, seen[c][name])


def _add_sweep(
    found: _Collection, sweep: Swept, seen: Mapping[str, FloatArray], board: Board
) -> None:
    views: dict[str, tuple[int, FloatArray]] = {}
    swept = zip(sweep.images, sweep.placements, sweep.readings_rad, strict=True)
    for name, placement, reading in swept:
        if not _shown(seen, name) or (1, seen[name].tobytes()) in found.known:
            continue
        if placement not in views:
            views[placement] = found.new_view(), seen[name]
        view, first = views[placement]
        pixels = seen[name]
        if half_turn_looks_same(board):
            # C2 turns about an axis near its image y axis: a board at rest stays upright.
            ways = [np.nanmean(np.diff(p, axis=0), axis=0) for p in (first, pixels)]
            pixels = pixels if ways[0] @ ways[1] > 0 else pixels[::-1].copy()
        found.add(name, "sweep", 1, view, pixels, found.at(float(reading)))


def _require_turns(pictures: BoardPictures) -> None:
    """Raise EstimationError unless both cameras see boards and C2 turns."""
    turned = pictures.exposure >= 0
    both = np.intersect1d(pictures.view[turned], pictures.view[pictures.camera == 0])
    if len(both) < MIN_VIEWS:
        raise EstimationError(
            f"{len(both)} boards are seen by both cameras at a known reading and {MIN_VIEWS} are "
            "needed: add stereo pairs, or pictures of both cameras to the gaze rows"
        )
    readings = pictures.readings_rad[pictures.exposure[turned]]
    if np.ptp(readings) < ENOUGH_TURN_RAD:
        raise EstimationError(
            f"C2 turned by {np.degrees(np.ptp(readings)):.1f} deg and "
            f"{np.degrees(ENOUGH_TURN_RAD):.0f} are needed: add a yaw sweep, or pictures of both "
            "cameras to the gaze rows"
        )


def _start(problem: AdjustmentProblem) -> tuple[FloatArray, FloatArray]:
    """Return a rig, shape (13,), and board poses, shape (v, 6), by single views."""
    pictures = problem.pictures
    single = np.array(
        [
            single_view_pose(problem.cameras[c], points=problem.points, pixels=pixels)[0]
            for c, pixels in zip(pictures.camera, pictures.pixels, strict=True)
        ]
    )
    of_c1 = {v: i for i, v in enumerate(pictures.view) if pictures.camera[i] == 0}
    turned = np.flatnonzero(pictures.exposure >= 0)
    both = [i for i in turned if pictures.view[i] in of_c1]
    poses_12 = np.array(
        [
            pose_matrix(single[of_c1[pictures.view[i]]]) @ np.linalg.inv(pose_matrix(single[i]))
            for i in both
        ]
    )
    readings = pictures.readings_rad[pictures.exposure[both]]
    rig = _rig_start(poses_12, readings, single[both, 5], problem)
    poses = np.zeros((pictures.views, 6))
    chosen: dict[int, int] = dict(of_c1)
    for view in range(pictures.views):
        own = np.flatnonzero(pictures.view == view)
        i = chosen.get(view, int(own[len(own) // 2]))
        poses[view] = single[i]
        if pictures.exposure[i] >= 0:
            reading = float(pictures.readings_rad[pictures.exposure[i]])
            poses[view] = pose_vector(pose_of(rig, reading) @ pose_matrix(single[i]))
    return rig, poses


def _rig_start(
    poses_12: FloatArray, readings: FloatArray, depths: FloatArray, problem: AdjustmentProblem
) -> FloatArray:
    """Return the rig that poses of C2 by single views show, the encoder's errors left out."""
    turn = np.arctan2(poses_12[:, 0, 2], poses_12[:, 2, 2])
    rig = np.zeros(len(RIG))
    rig[RIG.index("baseline_mm")] = np.median(poses_12[:, 0, 3])
    rig[RIG.index("delta2_rad")] = np.median(turn - (readings - ENCODER_CENTRE_RAD))
    free = [i for i, name in enumerate(RIG) if name not in ENCODER or name == "delta2_rad"]
    mean, std = np.array(problem.prior)[free].T
    scale = np.array([PARAMETERS[INDEX[RIG[i]]].scale if RIG[i] in INDEX else 1.0 for i in free])
    wide = np.where(np.isfinite(std), std, np.where(scale < 1, np.inf, _MOUNT_MM * 10))
    missed = partial(_missed, rig, free, poses_12, readings, depths, mean, wide)
    found = least_squares(missed, rig[free], x_scale=scale, loss="soft_l1")
    rig[free] = found.x
    return rig


def _missed(
    rig: FloatArray,
    free: list[int],
    poses_12: FloatArray,
    readings: FloatArray,
    depths: FloatArray,
    mean: FloatArray,
    std: FloatArray,
    x: FloatArray,
) -> FloatArray:
    """Return by how much a rig misses poses of C2, in what single views leave uncertain."""
    tried = rig.copy()
    tried[free] = x
    parts = [(x - mean) / std]
    for pose, reading, depth in zip(poses_12, readings, depths, strict=True):
        expected = pose_of(tried, float(reading))
        parts.append(cv2.Rodrigues(expected[:3, :3].T @ pose[:3, :3])[0].ravel() / _TURN)
        parts.append((expected[:3, 3] - pose[:3, 3]) / (_SHIFT * depth))
    return np.concatenate(parts)
