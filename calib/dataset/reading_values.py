"""Values that no reading of the rig has, whether they come in a table or in arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.dataset.plausible import LARGEST_COTANGENT, LARGEST_NORMALISED, RADIANS_BELOW


def value_faults(values: Mapping[str, FloatArray]) -> dict[int, str]:
    """Return why readings cannot be measured, by their place; the first reason counts.

    Parameters
    ----------
    values
        Columns of readings by name, shape (n,) each. NaN raises no doubt.
    """
    faults: dict[int, str] = {}
    for bad, fault in _doubts(values):
        for i in map(int, np.flatnonzero(bad)):
            if i not in faults:
                faults[i] = fault(i)
    return faults


def not_numbers(values: Mapping[str, FloatArray]) -> dict[int, str]:
    """Return which readings have a value that is no finite number, by their place."""
    return {
        int(i): f"{name} {column[i]:g} is not a finite number"
        for name, column in list(values.items())[::-1]
        for i in np.flatnonzero(~np.isfinite(column))
    }


def _doubts(
    values: Mapping[str, FloatArray],
) -> Iterator[tuple[BoolArray, Callable[[int], str]]]:
    if (degrees := values.get("alpha2_deg")) is not None:
        yield (degrees <= 0) | (degrees >= 180), partial(_outside, degrees)
        yield degrees < RADIANS_BELOW, partial(_radians, degrees)
    if (cotangent := values.get("ctan_alpha2")) is not None:
        yield np.abs(cotangent) > LARGEST_COTANGENT, partial(_angle, cotangent)
    for column in ("x1c", "y1c"):
        if (found := values.get(column)) is not None:
            yield np.abs(found) > LARGEST_NORMALISED, partial(_pixels, column, found)


def _outside(degrees: FloatArray, row: int) -> str:
    """Return what is wrong with a reading that is outside (0, 180)."""
    value = float(degrees[row])
    if -90 < value < 0:
        guess = ": counted about 0? at 90 C2 looks parallel to Z of C1"
    elif abs(value) > 360 and value.is_integer():
        guess = ": a count? give it times resolution_deg"
    else:
        guess = ""
    return f"alpha2_deg {value:g} is outside (0, 180){guess}"


def _radians(degrees: FloatArray, row: int) -> str:
    return f"alpha2_deg {degrees[row]:g}: radians? give degrees"


def _angle(cotangent: FloatArray, row: int) -> str:
    return f"ctan_alpha2 {cotangent[row]:g} looks like an angle"


def _pixels(column: str, values: FloatArray, row: int) -> str:
    return f"{column} {values[row]:g} looks like pixels"
