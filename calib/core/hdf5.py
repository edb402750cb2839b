"""HDF5 in memory: files are written whole by `stages.store`, and read without trusting them."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from typing import Any

import h5py
import numpy as np

_NUMBERS = "biuf"
"""Kinds of arrays that are read: booleans, integers, floats. Nothing that refers or evaluates."""

_DAMAGED = (OSError, RuntimeError, ArithmeticError, LookupError, TypeError, MemoryError)
"""What h5py raises, by where the damage lies."""


def hdf5_bytes(fill: Callable[[h5py.File], None]) -> bytes:
    """Return the HDF5 file that `fill` writes, as bytes.

    In memory, because a disk that fills up while HDF5 has a file open leaves it unable to close it.
    """
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        fill(file)
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def hdf5_arrays(image: bytes) -> Mapping[str, np.ndarray[Any, Any]]:
    """Return the arrays at the top of an HDF5 file, by name.

    Raises
    ------
    ValueError
        If it is no HDF5 file, or holds anything but plain arrays of numbers that lie in it.
    """
    try:
        with h5py.File(io.BytesIO(image), "r") as file:
            return {name: _array(file, name, len(image)) for name in file}
    except _DAMAGED as error:
        raise ValueError(f"no readable HDF5: {error}") from error


def _array(file: h5py.File, name: str, limit: int) -> np.ndarray[Any, Any]:
    """Return one array, or raise ValueError: links and claimed sizes lead out of the file."""
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"{name} is a link")
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset) or dataset.is_virtual or dataset.external:
        raise ValueError(f"{name} is no array of this file")
    if dataset.dtype.kind not in _NUMBERS or dataset.size * dataset.dtype.itemsize > limit:
        raise ValueError(f"{name} is no array of numbers, or too large")
    values: np.ndarray[Any, Any] = np.asarray(dataset[()])
    return values
