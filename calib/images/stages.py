"""The image stages as the pipeline calls them: files in, one frozen result out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.random import SeedSequence
from numpy.typing import NDArray

from calib.arrays import FloatArray
from calib.geometry.camera import Camera
from calib.images.detect import detect
from calib.images.intrinsics import Intrinsics, calibrate_intrinsics
from calib.images.picture import read_grey, thumbnail
from calib.images.sightings import pick
from calib.images.stereo import StereoReference, given_reference, stereo_reference
from calib.images.stereo_solve import CameraPair
from calib.images.sweep import SweepResult, yaw_sweep
from calib.images.sweep_solve import SweepReadings
from calib.images.types import Board, Corners

CONTACT_COUNT = 24
"""Pictures on a contact sheet; a board not found always gets its place."""

CONTACT_WIDTH_PX = 200


@dataclass(frozen=True)
class Pictures:
    """Images of one camera.

    Parameters
    ----------
    camera
        "c1" or "c2".
    names
        Relative to the dataset's folder, each once.
    sha256
        Of their bytes; "" for one that is known from a corner cache and need not exist.
    image_size
        Width and height, px; None to take those of the first picture.
    """

    camera: str
    names: tuple[str, ...]
    sha256: tuple[str, ...]
    image_size: tuple[int, int] | None


@dataclass(frozen=True)
class Known:
    """Corners that need not be detected, by image, px, shape (corners, 2)."""

    corners: Mapping[str, FloatArray]


def find_corners(
    folder: Path,
    pictures: Pictures,
    board: Board,
    known: Known,
    *,
    detector: str,
    progress: Callable[[int, int], None] | None = None,
) -> Corners:
    """Find the board in all images of a camera, each read once.

    Raises
    ------
    InputError
        Naming every image that cannot be used.
    """
    size = pictures.image_size or _size(folder, pictures)
    return detect(
        folder,
        pictures.names,
        board,
        image_size=size,
        detector=detector,
        cache=known.corners,
        progress=progress,
    )


def _size(folder: Path, pictures: Pictures) -> tuple[int, int]:
    there = (n for n, sha in zip(pictures.names, pictures.sha256, strict=True) if sha)
    first = next(there)
    height, width = read_grey(folder / first, name=first).shape
    return width, height


@dataclass(frozen=True)
class ContactSheet:
    """Small pictures with their corners drawn.

    Parameters
    ----------
    camera
        "c1" or "c2".
    names, detectors
        Of the pictures shown.
    pictures
        Blue, green, red, shape (n, height, width, 3).
    left_out
        Number of pictures not shown.
    """

    camera: str
    names: tuple[str, ...]
    detectors: tuple[str, ...]
    pictures: NDArray[np.uint8]
    left_out: int


def contact_sheet(folder: Path, pictures: Pictures, corners: Corners) -> ContactSheet:
    """Return a contact sheet: boards not found first, the rest evenly over the pictures."""
    here = np.flatnonzero([bool(sha) for sha in pictures.sha256])
    missed = [i for i in here if corners.detector[i] == "none"][:CONTACT_COUNT]
    others = np.array([i for i in here if corners.detector[i] != "none"], dtype=int)
    room = min(CONTACT_COUNT - len(missed), len(others))
    spread = others[np.linspace(0, len(others) - 1, room).round().astype(int)] if room else []
    shown = [*missed, *spread]
    small = [
        thumbnail(
            read_grey(folder / pictures.names[i], name=pictures.names[i]),
            corners.pixels[i],
            width=CONTACT_WIDTH_PX,
        )
        for i in shown
    ]
    return ContactSheet(
        camera=pictures.camera,
        names=tuple(pictures.names[i] for i in shown),
        detectors=tuple(corners.detector[i] for i in shown),
        pictures=np.stack(small) if small else np.zeros((0, 1, 1, 3), np.uint8),
        left_out=len(here) - len(shown),
    )


@dataclass(frozen=True)
class Chosen:
    """Names of images of a camera, in an order that means something to the stage."""

    images: tuple[str, ...]


def intrinsics(
    corners: Corners, chosen: Chosen, board: Board, *, camera: str, seed: SeedSequence
) -> Intrinsics:
    """Calibrate a camera from its intrinsic images."""
    views = pick(corners, chosen.images)
    return calibrate_intrinsics(views, board, camera=camera, seed=_number(seed))


def _number(seed: SeedSequence) -> int:
    return int(seed.generate_state(1)[0])


@dataclass(frozen=True)
class KnownCamera:
    """A camera with the covariance of its intrinsics; zeros where it was given."""

    camera: Camera
    covariance: FloatArray


def camera_pair(c1: KnownCamera | Intrinsics, c2: KnownCamera | Intrinsics) -> CameraPair:
    """Return both cameras as the later stages need them."""
    return CameraPair((c1.camera, c2.camera), (c1.covariance, c2.covariance))


@dataclass(frozen=True)
class Pairs:
    """Stereo pairs: stem and the images of C1 and C2; 1T2 where it is given."""

    stems: tuple[str, ...]
    images_c1: tuple[str, ...]
    images_c2: tuple[str, ...]
    transform_12: FloatArray | None


def stereo(
    corners_c1: Corners,
    corners_c2: Corners,
    pairs: Pairs,
    board: Board,
    rig: CameraPair,
    *,
    seed: SeedSequence,
) -> StereoReference:
    """Solve the stereo reference, or take the pose given."""
    views = pick(corners_c1, pairs.images_c1), pick(corners_c2, pairs.images_c2)
    if pairs.transform_12 is not None:
        return given_reference(
            views, board, rig, stems=pairs.stems, transform_12=pairs.transform_12
        )
    return stereo_reference(views, board, rig, stems=pairs.stems, seed=_number(seed))


@dataclass(frozen=True)
class SweepInput:
    """Images of C2 in a sweep, in the order of its readings, and priors of the encoder."""

    images: tuple[str, ...]
    readings: SweepReadings
    priors: Mapping[str, tuple[float, float]]


def sweep(
    corners_c2: Corners,
    given: SweepInput,
    board: Board,
    c2: KnownCamera | Intrinsics,
    reference: StereoReference | None,
) -> SweepResult:
    """Solve the yaw sweep, with what the stereo stage knows of the rig and the board."""
    solves = reference.solves if reference is not None else ()
    return yaw_sweep(
        pick(corners_c2, given.images),
        given.readings,
        board,
        camera=c2.camera,
        covariance=c2.covariance,
        pose_12=None if reference is None else reference.pose_12,
        warp_mm=solves[0].board_warp_mm if solves else None,
        priors=given.priors,
    )
