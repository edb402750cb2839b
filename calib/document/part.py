"""What all parts of calibration.json have in common."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field

Vector = tuple[float, ...]
Matrix = tuple[Vector, ...]

NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]

DIGITS = 12
"""Significant digits of the numbers in calibration.json: beyond them lies only rounding."""


class Part(BaseModel):
    """A section; it holds the keys below and no others.

    A number that does not exist (infinite, not a number) is not written.
    """

    model_config = ConfigDict(
        frozen=True, strict=True, extra="forbid", validate_by_name=True, defer_build=True
    )


class FinitePart(Part):
    """A section that measuring relies on: all its numbers exist."""

    model_config = ConfigDict(allow_inf_nan=False)


def vector(values: ArrayLike) -> Vector:
    """Return numbers of shape (n,) as a part holds them."""
    return tuple(np.asarray(values, dtype=float).tolist())


def matrix(values: ArrayLike) -> Matrix:
    """Return numbers of shape (n, m) as a part holds them."""
    return tuple(map(tuple, np.asarray(values, dtype=float).tolist()))


def written(part: Part) -> dict[str, Any]:
    """Return a part as JSON values, floats to `DIGITS`; what it has no value for is left out.

    A number that does not exist is absent from a mapping and null in a list, where leaving it out
    would move the others.
    """
    found: dict[str, Any] = _json(part.model_dump(by_alias=True))
    return found


def _json(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    if isinstance(value, Mapping):
        items = ((key, _json(item)) for key, item in value.items())
        return {key: item for key, item in items if item is not None}
    if isinstance(value, tuple | list):
        return [_json(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _json(value.tolist())
    return value
