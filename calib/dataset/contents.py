"""A dataset as the rest of the toolchain sees it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from calib.core.arrays import FloatArray
from calib.core.owner import Owner
from calib.dataset.manifest import Manifest
from calib.dataset.messages import row_place
from calib.dataset.tables import GazeTable, LengthTable, ReturnTable, SweepTable
from calib.geometry.board import Board
from calib.geometry.camera import Camera


@dataclass(frozen=True)
class Dataset:
    """A dataset, read and checked.

    Parameters
    ----------
    root
        Its folder, links resolved.
    manifest
        What dataset.toml says.
    sha256
        Fingerprint of the manifest, the tables and all files they name: of names and bytes.
    gaze, validation, sweep, lengths, returns
        The tables; None where the manifest names none.
    board
        None if the manifest has none. Its target is the corner next to the middle where the
        manifest states none and nothing rests on it.
    images
        Intrinsic images of "c1" and "c2", sorted, relative to `root`; no entry where none are used.
    stereo_pairs
        Images of C1 and C2 by their common stem.
    cameras
        Given cameras, from the manifest or a model file, by "c1" and "c2".
    corner_cache
        Corners found before, by image: px, shape (corners, 2), NaN where missing. An image named
        here need not exist.
    warnings
        What is no fault but may be a slip.
    image_sha256
        SHA-256, in hex, of the images that exist, by relative name; part of `sha256`. Who decodes
        one later holds its bytes against this.
    """

    root: Path
    manifest: Manifest
    sha256: str
    gaze: GazeTable | None
    validation: GazeTable | None
    sweep: SweepTable | None
    lengths: LengthTable | None
    returns: ReturnTable | None
    board: Board | None
    images: Mapping[str, tuple[str, ...]]
    stereo_pairs: Mapping[str, tuple[str, str]]
    cameras: Mapping[str, Camera]
    corner_cache: Mapping[str, FloatArray]
    warnings: tuple[str, ...]
    image_sha256: Mapping[str, str]

    @property
    def rows(self) -> tuple[GazeTable, ...]:
        """The tables of gazes there are."""
        return tuple(table for table in (self.gaze, self.validation) if table is not None)

    @property
    def owner(self) -> Owner:
        """What it says of itself to the folder of its run."""
        manifest = self.manifest
        certified = None if manifest.certificate is None else manifest.certificate.serial
        rig = None if manifest.rig is None else manifest.rig.serial
        return Owner(self.root, self.sha256, manifest.name, certified or rig or "")

    @property
    def row_images(self) -> Mapping[str, str]:
        """Images that rows of gaze, validation and sweep name, with the place that names them."""
        places: dict[str, str] = {}
        for table in (*self.rows, *((self.sweep,) if self.sweep is not None else ())):
            for column in ("image_c1", "image_c2"):
                for i, image in enumerate(getattr(table, column, ())):
                    if image is not None:
                        places[image] = row_place(table.file, table.line[i], table.ids[i], column)
        return places


def given_camera(dataset: Dataset, name: str) -> Camera | None:
    """Return the finished camera "c1" or "c2" that the dataset brings, None if it brings none."""
    return dataset.cameras.get(name)
