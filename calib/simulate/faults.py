"""Mistakes that labs make, made in simulated tables: for tests of the diagnosis, and to learn.

The names are those of `calib.diagnosis.hypotheses`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.core.errors import UsageError
from calib.dataset.messages import suggestion
from calib.rows.observations import Observations

DEG = float(np.deg2rad(1.0))

GROUP = 3
"""Rows a pose, where a fault is one of poses."""

FULL_STEP_COUNTS = 16
"""Microsteps a full step."""

MIXED = 5
"""One row in so many is in another unit."""


@dataclass(frozen=True)
class Context:
    """What a fault needs beside rows and its size.

    Parameters
    ----------
    step_rad
        One count of the encoder.
    rng
        For what is random of it.
    """

    step_rad: float
    rng: np.random.Generator


Spoil = Callable[[Observations, float, Context], Observations]


@dataclass(frozen=True)
class Fault:
    """A mistake.

    Parameters
    ----------
    value
        Its size if none is asked for, in `unit`.
    spoil
        Makes the mistake.
    everywhere
        Whether validation rows have it too, as the rig itself has it.
    left
        What is left of it in validation rows, which are taken after the calibration rows.
    """

    value: float
    unit: str
    spoil: Spoil
    everywhere: bool = False
    left: Spoil | None = None


def _shift(rows: Observations, by_rad: FloatArray) -> Observations:
    return replace(rows, alpha2_rad=rows.alpha2_rad + by_rad)


def _place(rows: Observations) -> IntArray:
    return np.arange(len(rows))


def _range(rows: Observations, _value: float, _: Context) -> Observations:
    return replace(rows, z_mm=rows.z_mm * np.sqrt(1 + rows.x1c**2 + rows.y1c**2))


def _step(rows: Observations, value: float, _: Context) -> Observations:
    return _shift(rows, np.where(_place(rows) >= len(rows) // 2, value * DEG, 0.0))


def _drift(rows: Observations, value: float, _: Context) -> Observations:
    return _shift(rows, value * DEG * _place(rows) / max(len(rows) - 1, 1))


def _at_the_end(rows: Observations, value: float, _: Context) -> Observations:
    return _shift(rows, np.full(len(rows), value * DEG))


def _rehomed(rows: Observations, value: float, _: Context) -> Observations:
    inside = (_place(rows) >= len(rows) // 3) & (_place(rows) < 2 * len(rows) // 3)
    return _shift(rows, np.where(inside, value * DEG, 0.0))


def _backlash(rows: Observations, value: float, context: Context) -> Observations:
    return _shift(rows, value * DEG / 2 * context.rng.choice([-1.0, 1.0], len(rows)))


def _microstep(rows: Observations, value: float, context: Context) -> Observations:
    phase = 2 * np.pi * rows.alpha2_rad / (FULL_STEP_COUNTS * context.step_rad)
    return _shift(rows, value * DEG * np.cos(phase))


def _twice(rows: Observations, value: float, _: Context) -> Observations:
    return _shift(rows, value * DEG * np.cos(2 * rows.alpha2_rad))


def _distortion(rows: Observations, value: float, _: Context) -> Observations:
    factor = 1 + value * (rows.x1c**2 + rows.y1c**2)
    return replace(rows, x1c=rows.x1c * factor, y1c=rows.y1c * factor)


def _focal(rows: Observations, value: float, _: Context) -> Observations:
    focal = 1 - value / 100
    return replace(rows, x1c=rows.x1c / focal, y1c=rows.y1c / focal)


def _poses(rows: Observations) -> Observations:
    names = tuple(f"p{1 + i // GROUP:02d}" for i in range(len(rows)))
    return replace(rows, groups=names)


def _near(rows: Observations, value: float, _: Context) -> Observations:
    near = rows.z_mm <= np.quantile(rows.z_mm, 1 / 3)
    return replace(_poses(rows), z_mm=rows.z_mm + value * near)


def _far(rows: Observations, value: float, _: Context) -> Observations:
    far = rows.z_mm >= np.quantile(rows.z_mm, 2 / 3)
    return replace(_poses(rows), z_mm=rows.z_mm * (1 + value / 100 * far))


def _group(rows: Observations, value: float, _: Context) -> Observations:
    return replace(_poses(rows), z_mm=rows.z_mm + value * (_place(rows) // GROUP == 1))


def _exchanged(rows: Observations, _value: float, _: Context) -> Observations:
    first = len(rows) // 3
    second = int(np.argmax(np.abs(rows.z_mm - rows.z_mm[first])))
    z = rows.z_mm.copy()
    z[[first, second]] = z[[second, first]]
    return replace(rows, z_mm=z)


def _unit(rows: Observations, value: float, _: Context) -> Observations:
    return replace(rows, z_mm=np.where(_place(rows) % MIXED == 1, rows.z_mm / value, rows.z_mm))


FAULTS: Mapping[str, Fault] = MappingProxyType(
    {
        "range-not-depth": Fault(1.0, "1", _range),
        "reference-offset": Fault(
            35.0, "mm", lambda rows, value, _: replace(rows, z_mm=rows.z_mm - value)
        ),
        "reference-scale": Fault(
            2.0, "%", lambda rows, value, _: replace(rows, z_mm=rows.z_mm * (1 + value / 100))
        ),
        "reference-bias-near": Fault(20.0, "mm", _near),
        "reference-bias-far": Fault(3.0, "%", _far),
        "reading-step": Fault(0.25, "deg", _step, left=_at_the_end),
        "reading-drift": Fault(0.25, "deg", _drift, left=_at_the_end),
        "backlash": Fault(0.3, "deg", _backlash),
        "microstep": Fault(0.1, "deg", _microstep, everywhere=True),
        "encoder-twice-per-turn": Fault(0.3, "deg", _twice, everywhere=True),
        "c1-distortion-left-in": Fault(-0.3, "1", _distortion, everywhere=True),
        "c1-principal-point": Fault(
            0.05, "1", lambda rows, value, _: replace(rows, x1c=rows.x1c + value), everywhere=True
        ),
        "c1-focal-length": Fault(4.0, "%", _focal, everywhere=True),
        "x-mirrored": Fault(
            1.0, "1", lambda rows, _value, _: replace(rows, x1c=-rows.x1c), everywhere=True
        ),
        "y-mirrored": Fault(
            1.0, "1", lambda rows, _value, _: replace(rows, y1c=-rows.y1c), everywhere=True
        ),
        "rows-exchanged": Fault(1.0, "1", _exchanged),
        "group-reference": Fault(30.0, "mm", _group),
        "unit": Fault(10.0, "1", _unit),
        "rehomed": Fault(0.25, "deg", _rehomed),
    }
)
"""Mistakes by name."""


def check_faults(faults: Mapping[str, float | None]) -> None:
    """Raise a UsageError if a name is none of a mistake."""
    for name, value in faults.items():
        if name not in FAULTS:
            raise UsageError(f"--fault {name}: unknown; {suggestion(name, tuple(FAULTS))}")
        if value is not None and not (np.isfinite(value) and value != 0):
            raise UsageError(f"--fault {name}={value:g}: give a number other than 0")


def size_of(name: str, value: float | None) -> float:
    """Return the size of a mistake, its usual one where none is asked for."""
    return FAULTS[name].value if value is None else value


def spoil(
    rows: Observations,
    faults: Mapping[str, float | None],
    context: Context,
    *,
    validation: bool = False,
) -> Observations:
    """Return rows with mistakes made on them, one after the other.

    Parameters
    ----------
    faults
        Size by name; None for the usual one.
    validation
        Whether these are validation rows, which have only what the rig itself has.
    """
    for name, value in faults.items():
        fault = FAULTS[name]
        made = fault.spoil if fault.everywhere or not validation else fault.left
        if made is not None:
            rows = made(rows, size_of(name, value), context)
    return rows
