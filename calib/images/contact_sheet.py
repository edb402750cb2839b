"""Stage: small copies of a camera's pictures, for the report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.geometry.board import Corners
from calib.images.detection.picture import read_grey, thumbnail

WIDTHS_PX = ((24, 640), (100, 400), (500, 200))
"""Up to so many pictures of a camera, each is so wide: sharp where they are few, and a report that
still opens where they are many."""

LEAST_WIDTH_PX = 120
"""Width where they are more."""


@dataclass(frozen=True)
class SheetPictures:
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
class ContactSheet:
    """Small copies of all pictures of a camera.

    Parameters
    ----------
    camera
        "c1" or "c2".
    names, detectors
        Of the pictures: boards not found first.
    pictures
        Grey values, shape (n, height, width).
    """

    camera: str
    names: tuple[str, ...]
    detectors: tuple[str, ...]
    pictures: NDArray[np.uint8]


def contact_sheet(folder: Path, pictures: SheetPictures, corners: Corners) -> ContactSheet:
    """Return small copies of all pictures that exist: boards not found first, then as they come."""
    here = [i for i, sha in enumerate(pictures.sha256) if sha]
    shown = sorted(here, key=lambda i: corners.detector[i] != "none")
    width = min(contact_width(len(shown)), corners.image_size[0])
    small = [
        thumbnail(
            read_grey(
                folder / pictures.names[i], name=pictures.names[i], sha256=pictures.sha256[i]
            ),
            width=width,
        )
        for i in shown
    ]
    return ContactSheet(
        camera=pictures.camera,
        names=tuple(pictures.names[i] for i in shown),
        detectors=tuple(corners.detector[i] for i in shown),
        pictures=np.stack(small) if small else np.zeros((0, 1, 1), np.uint8),
    )


def contact_width(count: int) -> int:
    """Return the width, px, of small copies of so many pictures."""
    return next((width for most, width in WIDTHS_PX if count <= most), LEAST_WIDTH_PX)
