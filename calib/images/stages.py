"""The image stages as the pipeline calls them: files in, one frozen result out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from numpy.random import SeedSequence

from calib.core.arrays import FloatArray
from calib.geometry.board import Board, Corners
from calib.geometry.camera import Camera
from calib.images.contact_sheet import SheetPictures
from calib.images.detection.find import detect
from calib.images.detection.picture import read_grey
from calib.images.intrinsics.calibrate import Intrinsics, calibrate_intrinsics
from calib.images.intrinsics.refine import refine
from calib.images.joint.gather import Extra
from calib.images.stereo.reference import StereoReference, given_reference, stereo_reference
from calib.images.stereo.solve import CameraPair
from calib.images.sweep.solve import SweepReadings
from calib.images.sweep.yaw_axis import SweepResult, yaw_sweep


@dataclass(frozen=True)
class KnownCorners:
    """Corners that need not be detected, by image, px, shape (corners, 2)."""

    corners: Mapping[str, FloatArray]


def find_corners(
    folder: Path,
    pictures: SheetPictures,
    board: Board,
    known: KnownCorners,
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
        sha256=dict(zip(pictures.names, pictures.sha256, strict=True)),
        progress=progress,
    )


def _size(folder: Path, pictures: SheetPictures) -> tuple[int, int]:
    there = zip(pictures.names, pictures.sha256, strict=True)
    first, sha256 = next((name, sha) for name, sha in there if sha)
    height, width = read_grey(folder / first, name=first, sha256=sha256).shape
    return width, height


@dataclass(frozen=True)
class Chosen:
    """Names of images of a camera, in an order that means something to the stage."""

    images: tuple[str, ...]


def intrinsics(
    corners: Corners, chosen: Chosen, board: Board, *, camera: str, seed: SeedSequence
) -> Intrinsics:
    """Calibrate a camera from its intrinsic images."""
    views = corners.select(chosen.images)
    return calibrate_intrinsics(views, board, camera=camera, seed=_number(seed))


def _number(seed: SeedSequence) -> int:
    return int(seed.generate_state(1)[0])


@dataclass(frozen=True)
class KnownCamera:
    """A camera with the covariance of its intrinsics; zeros where it was given."""

    camera: Camera
    covariance: FloatArray


@dataclass(frozen=True)
class Pairs:
    """Stereo pairs: stem and the images of C1 and C2; 1T2 where it is given."""

    stems: tuple[str, ...]
    images_c1: tuple[str, ...]
    images_c2: tuple[str, ...]
    transform_12: FloatArray | None


@dataclass(frozen=True)
class Besides:
    """Images of C1 and C2 besides those of pairs: of lenses, less those rejected; of rows."""

    lens: tuple[tuple[str, ...], tuple[str, ...]]
    rows: tuple[tuple[str, ...], tuple[str, ...]]


def stereo(
    corners_c1: Corners,
    corners_c2: Corners,
    pairs: Pairs,
    besides: Besides,
    board: Board,
    rig: CameraPair,
    *,
    seed: SeedSequence,
) -> StereoReference:
    """Solve the stereo reference with both lenses, or take the pose given."""
    views = corners_c1.select(pairs.images_c1), corners_c2.select(pairs.images_c2)
    if pairs.transform_12 is not None:
        return given_reference(
            views, board, rig, stems=pairs.stems, transform_12=pairs.transform_12
        )
    both = corners_c1, corners_c2
    one, two = (
        Extra(found.select(lens), found.select(rows))
        for found, lens, rows in zip(both, besides.lens, besides.rows, strict=True)
    )
    number = _number(seed)
    return stereo_reference(views, board, rig, stems=pairs.stems, seed=number, extra=(one, two))


def refined(found: Intrinsics, reference: StereoReference | None, corners: Corners) -> Intrinsics:
    """Return a camera's intrinsics by the joint solve, where there is one."""
    lenses = () if reference is None else reference.lenses
    own = [lens for lens in lenses if lens.name == found.name]
    return refine(found, own[0], corners) if own else found


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
        corners_c2.select(given.images),
        given.readings,
        board,
        camera=c2.camera,
        covariance=c2.covariance,
        pose_12=None if reference is None else reference.pose_12,
        warp_mm=solves[0].board_warp_mm if solves else None,
        priors=given.priors,
    )
