"""Stage: small pictures of a camera with the corners that were found."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.geometry.board import Corners
from calib.images.detection.picture import read_grey, thumbnail

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
            read_grey(
                folder / pictures.names[i], name=pictures.names[i], sha256=pictures.sha256[i]
            ),
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
