"""Image files as grey pictures of 8 bits, and small copies of them for reports."""

from __future__ import annotations

import hashlib
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.core.arrays import FloatArray
from calib.core.errors import InputError
from calib.dataset.picture_header import LARGEST_BYTES, header_fault, picture_header
from calib.images.detection.cut_jpeg import is_cut

Grey = NDArray[np.uint8]

TAIL_SHARE = 0.001
"""Share of darkest and of brightest pixels that deep images may clip: hot pixels, not the board."""

_READ = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


def read_grey(path: Path, *, name: str, sha256: str = "") -> Grey:
    """Return an image as grey values of 8 bits, shape (height, width).

    The file is read once: its header is looked at, its bytes hashed, and these bytes decoded.
    Pixels stay where the imager had them: a turn asked for by EXIF is ignored. Images deeper than 8
    bits are scaled by their content.

    Parameters
    ----------
    name
        What messages call the file.
    sha256
        Of the bytes that are wanted, in hex; "" for any.

    Raises
    ------
    InputError
        If the file is missing, unreadable, truncated, too large or no image, or has other bytes.
    """
    data = _bytes(path, name)
    fault = header_fault(picture_header(BytesIO(data)))
    if fault is not None:
        raise InputError.single(where=name, what=fault[0], remedy=fault[1])
    if sha256 and hashlib.sha256(data).hexdigest() != sha256:
        raise InputError.single(
            where=name,
            what="the file has changed since the dataset was read",
            remedy="let nothing write to the dataset during a run, and run again",
        )
    try:
        image = None if is_cut(data) else _decode(data)
        if image is not None:
            eight = image.itemsize == 1
            return image.astype(np.uint8) if eight else _to_8_bit(image.astype(np.float64))
    except MemoryError:
        raise InputError.single(
            where=name,
            what="there is too little memory for the image",
            remedy="free some, or take the image out of the dataset",
        ) from None
    raise InputError.single(
        where=name,
        what="the file is truncated or no image",
        remedy="copy it again from the camera, or take it out of the dataset",
    )


def _bytes(path: Path, name: str) -> bytes:
    """Return the bytes of a file, up to those of the largest picture."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise InputError.single(
            where=name,
            what=f"the image cannot be read ({error.strerror or error})",
            remedy="check the name in the manifest and the file's permissions",
        ) from error
    if len(data) > LARGEST_BYTES:
        raise InputError.single(
            where=name,
            what="the file is larger than 1 GiB",
            remedy="it is no picture of a camera: take it out of the dataset",
        )
    return data


def _decode(data: bytes) -> NDArray[np.generic] | None:
    """Return the decoded image, or None if it is none."""
    try:
        image: NDArray[np.generic] | None = cv2.imdecode(np.frombuffer(data, np.uint8), _READ)
    except cv2.error as error:
        if error.code == cv2.Error.StsNoMem:
            raise MemoryError from None
        return None
    return image


def _to_8_bit(image: FloatArray) -> Grey:
    """Scale the range of the content, but for its tails, to 0 to 255."""
    low, high = np.nanquantile(image, [TAIL_SHARE, 1 - TAIL_SHARE])
    scaled = (image - low) * (255.0 / (high - low) if high > low else 0.0)
    grey: Grey = np.clip(np.nan_to_num(scaled), 0, 255).round().astype(np.uint8)
    return grey


def thumbnail(image: Grey, *, width: int) -> Grey:
    """Return a small copy of an image, `width` px wide."""
    size = (width, max(1, round(image.shape[0] * width / image.shape[1])))
    small: Grey = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return small
