"""The image half of the chain: corners, intrinsics, stereo reference, yaw sweep, observations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from calib.core.arrays import FloatArray
from calib.dataset.contents import Dataset
from calib.dataset.given_lens import given_lens_covariance
from calib.dataset.tables import GazeTable
from calib.fit.priors import MeasuredParameters
from calib.geometry.board import Corners
from calib.geometry.camera import intrinsic_names
from calib.images import stages as images_stages
from calib.images.contact_sheet import ContactSheet, SheetPictures, contact_sheet
from calib.images.intrinsics.calibrate import Intrinsics
from calib.images.result import ImageResult
from calib.images.stages import (
    Besides,
    Chosen,
    KnownCamera,
    KnownCorners,
    Pairs,
    SweepInput,
    find_corners,
)
from calib.images.stereo.reference import StereoReference
from calib.images.stereo.solve import CameraPair
from calib.images.sweep.solve import SweepReadings
from calib.images.sweep.yaw_axis import SweepResult
from calib.rows.common_errors import CommonErrors
from calib.rows.from_images import CornerNoise, observe_images, shared_errors
from calib.rows.from_table import CameraSet, ImageObservations
from calib.stages.store import Staged, Store, given, optional, stage

CAMERAS = ("c1", "c2")


@dataclass(frozen=True)
class ImageStages:
    """What the images gave, as inputs of later stages; None where there are no data for it."""

    corners: Mapping[str, Staged[Corners]]
    sheets: Mapping[str, Staged[ContactSheet]]
    intrinsics: Mapping[str, Staged[Intrinsics]]
    stereo: Staged[StereoReference] | None
    sweep: Staged[SweepResult] | None
    cameras: CameraSet
    shared: Staged[CommonErrors]
    pairs: Mapping[str, tuple[str, str]]

    def failures(self) -> dict[str, str]:
        """Return why stages gave no result, by their names."""
        stages = [*self.intrinsics.values(), self.stereo, self.sweep]
        return {s.name: s.failed for s in stages if s is not None and s.failed is not None}

    def result(self) -> ImageResult:
        """Return all that the images gave."""
        return ImageResult(
            corners={name: stage.value for name, stage in self.corners.items()},
            sheets={name: stage.value for name, stage in self.sheets.items()},
            intrinsics={n: s.value for n, s in self.intrinsics.items() if s.failed is None},
            stereo=None if self.stereo is None else self.stereo.get(),
            sweep=None if self.sweep is None else self.sweep.get(),
            pairs=self.pairs,
        )

    def measured(self) -> MeasuredParameters | None:
        """Return the sweep's knowledge of the model's parameters."""
        result = None if self.sweep is None else self.sweep.get()
        if result is None:
            return None
        return MeasuredParameters(result.names, result.mean, result.covariance)


def image_stages(dataset: Dataset, store: Store, seed: int) -> ImageStages:
    """Run all image stages that the dataset has data for."""
    # The path is no part of what a result depends on: the pictures' bytes are.
    folder = Staged("folder", "", lambda: dataset.root)
    board = None if dataset.board is None else given("board", dataset.board)
    corners: dict[str, Staged[Corners]] = {}
    sheets: dict[str, Staged[ContactSheet]] = {}
    for camera in CAMERAS:
        pictures = _pictures(dataset, camera)
        if pictures is None or board is None:
            continue
        known = {n: c for n, c in dataset.corner_cache.items() if n in pictures.names}
        asked = given(f"pictures {camera}", pictures)
        cached = given("known corners", KnownCorners(known))
        # fmt: off
        corners[camera] = store.run(stage(
            f"corners {camera}", find_corners,
            folder, asked, board, cached, detector=_detector(dataset),
        ))
        sheets[camera] = store.run(stage(
            f"contact sheet {camera}", contact_sheet, folder, asked, corners[camera],
        ))
        # fmt: on
    intrinsics: Mapping[str, Staged[Intrinsics]] = store.run_all(
        {
            camera: stage(
                f"intrinsics {camera}", images_stages.intrinsics,
                corners[camera], given("views", Chosen(images)), board, camera=camera, seed=seed,
            )
            for camera, images in dataset.images.items()
            if board is not None
        }
    )  # fmt: skip
    rig = camera_pair(dataset, intrinsics)
    stereo = _stereo(dataset, store, corners, board, rig, intrinsics, seed)
    intrinsics = _refined(store, corners, intrinsics, stereo)
    rig = camera_pair(dataset, intrinsics)
    sweep = _sweep(dataset, store, corners, board, intrinsics, stereo)
    shared = given("shared errors", CommonErrors())
    if rig is not None:
        good = stereo if stereo is not None and stereo.failed is None else None
        shared = store.run(stage("shared errors", shared_errors, rig, optional(good)))
    elif dataset.cameras:
        shared = given("shared errors", _of_given_lenses(dataset))
    return ImageStages(
        corners=corners,
        sheets=sheets,
        intrinsics=intrinsics,
        stereo=stereo,
        sweep=sweep,
        cameras=_camera_set(dataset, intrinsics),
        shared=shared,
        pairs=dataset.stereo_pairs,
    )


def image_observations(
    dataset: Dataset, table: GazeTable, store: Store, images: ImageStages, *, by: str = ""
) -> Staged[ImageObservations] | None:
    """Return what the images say of a table's rows; None if it names none.

    Parameters
    ----------
    by
        Whose cameras and shared errors `images` has, where they are not the image stages' own.
    """
    named = [n for n in (*table.image_c1, *table.image_c2, *table.stereo) if n is not None]
    if not named or dataset.board is None:
        return None
    noise = {name: stage.get() for name, stage in images.intrinsics.items()}
    fits = {name: fit.selected for name, fit in noise.items() if fit is not None}
    rms = {f"{name}_px": fit.rms_px for name, fit in fits.items()}
    warps = [fit.board_warp_mm for fit in fits.values() if fit.board_warp_mm is not None]
    known = CornerNoise(**rms, warp_mm=warps[0] if warps else None)
    return store.run(stage(
        f"{by}image observations {table.file}", observe_images,
        given("table", table), given("board", dataset.board),
        optional(images.corners.get("c1")), optional(images.corners.get("c2")),
        optional(images.stereo), images.shared, given("corner noise", known),
        given("cameras", images.cameras),
    ))  # fmt: skip


def _pictures(dataset: Dataset, camera: str) -> SheetPictures | None:
    """Return all images of a camera, each once; None if it has none."""
    names = tuple(dict.fromkeys(_named(dataset, camera)))
    if not names:
        return None
    stated = dataset.manifest.camera(camera)
    size = None if stated is None else stated.image_size
    if size is None and camera in dataset.cameras:
        size = dataset.cameras[camera].image_size
    hashes = tuple(
        "" if name in dataset.corner_cache else dataset.image_sha256[name] for name in names
    )
    return SheetPictures(camera, names, hashes, size)


def _detector(dataset: Dataset) -> str:
    board = dataset.manifest.board
    return "cascade" if board is None else board.detector


def _named(dataset: Dataset, camera: str) -> Iterator[str]:
    """Yield the images of a camera that any part of the dataset names."""
    which = CAMERAS.index(camera)
    yield from dataset.images.get(camera, ())
    yield from (pair[which] for pair in dataset.stereo_pairs.values())
    for table in dataset.rows:
        column = (table.image_c1, table.image_c2)[which]
        yield from (name for name in column if name is not None)
    if camera == "c2" and dataset.sweep is not None:
        yield from dataset.sweep.image_c2


def _known_camera(
    dataset: Dataset, intrinsics: Mapping[str, Staged[Intrinsics]], name: str
) -> Staged[Any] | None:
    """Return a camera's stage if it has a result, else the camera given, else None."""
    if name in intrinsics:
        return intrinsics[name] if intrinsics[name].failed is None else None
    camera = dataset.cameras.get(name)
    if camera is None:
        return None
    covariance = given_lens_covariance(dataset, name)
    return given(f"camera {name}", KnownCamera(camera, covariance))


def _of_given_lenses(dataset: Dataset) -> CommonErrors:
    """Return what all rows have wrong by given lenses, where tables name their pixels."""
    names = [f"{n}.{part}" for n, c in dataset.cameras.items() for part in intrinsic_names(c)]
    blocks = [given_lens_covariance(dataset, name) for name in dataset.cameras]
    return CommonErrors.of(tuple(names), block_diag(*blocks))


def _camera_set(dataset: Dataset, intrinsics: Mapping[str, Staged[Intrinsics]]) -> CameraSet:
    stages = [_known_camera(dataset, intrinsics, name) for name in CAMERAS]
    c1, c2 = (None if stage is None else stage.value.camera for stage in stages)
    return CameraSet(c1, c2)


def camera_pair(
    dataset: Dataset, intrinsics: Mapping[str, Staged[Intrinsics]]
) -> Staged[CameraPair] | None:
    """Return both cameras, if both are known and pictures are taken with them."""
    c1, c2 = (_known_camera(dataset, intrinsics, name) for name in CAMERAS)
    if c1 is None or c2 is None or dataset.board is None:
        return None
    both = c1.value, c2.value
    return given("camera pair", CameraPair(
        (both[0].camera, both[1].camera),
        (both[0].covariance, both[1].covariance),
        is_left=dataset.manifest.rig.is_left,
        free=("c1" in intrinsics, "c2" in intrinsics),
    ))  # fmt: skip


def _refined(
    store: Store,
    corners: Mapping[str, Staged[Corners]],
    intrinsics: Mapping[str, Staged[Intrinsics]],
    stereo: Staged[StereoReference] | None,
) -> Mapping[str, Staged[Intrinsics]]:
    """Return the intrinsics by the joint solve of lenses and pairs, where there is one."""
    if stereo is None or stereo.failed is not None or not stereo.value.lenses:
        return intrinsics
    return {
        name: found
        if found.failed is not None
        else store.run(stage(
            f"refined intrinsics {name}", images_stages.refined,
            found, optional(stereo), corners[name],
        ))
        for name, found in intrinsics.items()
    }  # fmt: skip


def besides_pairs(dataset: Dataset, intrinsics: Mapping[str, Staged[Intrinsics]]) -> Besides:
    """Return the images for lenses and rows, each once; validation is not used to fit."""
    lens, rows = [], []
    for which, name in enumerate(CAMERAS):
        own = dataset.images.get(name, ()) if name in intrinsics else ()
        rejected = intrinsics[name].value.rejected_views if name in intrinsics else ()
        lens.append(tuple(image for image in own if image not in rejected))
        columns = () if dataset.gaze is None else (dataset.gaze.image_c1, dataset.gaze.image_c2)
        named = [image for image in columns[which] if image is not None] if columns else []
        rows.append(tuple(dict.fromkeys(named)))
    return Besides((lens[0], lens[1]), (rows[0], rows[1]))


def _stereo(
    dataset: Dataset,
    store: Store,
    corners: Mapping[str, Staged[Corners]],
    board: Staged[Any] | None,
    rig: Staged[CameraPair] | None,
    intrinsics: Mapping[str, Staged[Intrinsics]],
    seed: int,
) -> Staged[StereoReference] | None:
    stated = dataset.manifest.stereo
    if stated is None or rig is None or board is None or not dataset.stereo_pairs:
        return None
    stems = tuple(dataset.stereo_pairs)
    pairs = Pairs(
        stems=stems,
        images_c1=tuple(dataset.stereo_pairs[s][0] for s in stems),
        images_c2=tuple(dataset.stereo_pairs[s][1] for s in stems),
        transform_12=None if stated.transform is None else _matrix(stated.transform),
    )
    return store.run(stage(
        "stereo", images_stages.stereo,
        corners["c1"], corners["c2"], given("pairs", pairs),
        given("images besides", besides_pairs(dataset, intrinsics)), board, rig, seed=seed,
    ))  # fmt: skip


def _matrix(rows: Any) -> FloatArray:
    return np.array(rows, dtype=np.float64)


def _sweep(
    dataset: Dataset,
    store: Store,
    corners: Mapping[str, Staged[Corners]],
    board: Staged[Any] | None,
    intrinsics: Mapping[str, Staged[Intrinsics]],
    stereo: Staged[StereoReference] | None,
) -> Staged[SweepResult] | None:
    table, encoder = dataset.sweep, dataset.manifest.encoder
    c2 = _known_camera(dataset, intrinsics, "c2")
    if table is None or encoder is None or board is None or c2 is None:
        return None
    readings = SweepReadings(
        alpha2_rad=np.array(table.alpha2_rad),
        placements=table.placements,
        resolution_rad=float(np.deg2rad(encoder.resolution_deg)),
        u_alpha2_rad=float(np.deg2rad(encoder.further_u_deg)),
    )
    priors = {name: (prior.mean, prior.std) for name, prior in dataset.manifest.priors.items()}
    asked = SweepInput(table.image_c2, readings, priors)
    good = stereo if stereo is not None and stereo.failed is None else None
    return store.run(stage(
        "sweep", images_stages.sweep,
        corners["c2"], given("sweep", asked), board, c2, optional(good),
    ))  # fmt: skip
