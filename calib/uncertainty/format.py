"""Numbers as certificate and report print them.

An uncertainty has two significant digits, ties rounded up (JCGM 100, 7.2.6: better up than down);
its value is rounded to the same place, ties to even (ISO 80000-1, B.3). Rounding works on the
shortest decimal that stands for the float: 0.125 is the tie it looks like, and so is 2.675, whose
binary neighbour lies just below. An interval is rounded outwards, so that it keeps its coverage.

Minus signs are ASCII here: strings are read by programs too. Templates may print them otherwise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import (
    ROUND_CEILING,
    ROUND_FLOOR,
    ROUND_HALF_EVEN,
    ROUND_HALF_UP,
    ROUND_UP,
    Decimal,
)

DIGITS = 2
"""Significant digits of an uncertainty."""

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class PrintedUnit:
    """A unit as printed, and the factor from the internal unit to it."""

    unit: str
    factor: float


SHOWN: dict[str, PrintedUnit] = {
    "mm": PrintedUnit("mm", 1.0),
    "rad": PrintedUnit("mrad", 1e3),
    "1": PrintedUnit("1", 1.0),
}
"""Printed units of the internal ones: milliradians keep small angles readable."""


@dataclass(frozen=True)
class Rounded:
    """A value with its uncertainty, both rounded, both in plain decimals."""

    value: str
    uncertainty: str


def _decimal(number: float) -> Decimal:
    return Decimal(repr(float(number)))


def _plain(number: Decimal) -> str:
    """Return plain decimals without an exponent and without a negative zero."""
    return f"{number:f}" if number else f"{abs(number):f}"


def last_place(uncertainty: float, *, digits: int = DIGITS) -> int:
    """Return the power of ten of the last significant digit of an uncertainty.

    Raises
    ------
    ValueError
        If the uncertainty is not positive and finite: it decides no place.
    """
    if not (math.isfinite(uncertainty) and uncertainty > 0):
        raise ValueError(f"an uncertainty must be positive and finite, not {uncertainty}")
    exact = _decimal(uncertainty)
    place = exact.adjusted() - digits + 1
    rounded = exact.quantize(Decimal(1).scaleb(place), ROUND_HALF_UP)
    return place + (rounded.adjusted() - exact.adjusted())


def _at(number: float, place: int, rounding: str) -> str:
    rounded = _decimal(number).quantize(Decimal(1).scaleb(place), rounding)
    return _plain(rounded + 0 if place <= 0 else Decimal(int(rounded)))


def with_uncertainty(value: float, uncertainty: float, *, digits: int = DIGITS) -> Rounded:
    """Return value and uncertainty, rounded to the same place."""
    place = last_place(uncertainty, digits=digits)
    return Rounded(
        value=_at(value, place, ROUND_HALF_EVEN), uncertainty=_at(uncertainty, place, ROUND_HALF_UP)
    )


def interval(low: float, high: float, *, uncertainty: float) -> tuple[str, str]:
    """Return the ends of an interval, rounded outwards to the place of `uncertainty`."""
    place = last_place(uncertainty)
    return _at(low, place, ROUND_FLOOR), _at(high, place, ROUND_CEILING)


def at_place(value: float, *, uncertainty: float) -> str:
    """Return a value rounded to the place of an uncertainty that is not printed beside it."""
    return _at(value, last_place(uncertainty), ROUND_HALF_EVEN)


def upwards_to(bound: float, *, uncertainty: float) -> str:
    """Return a bound rounded up to the place of `uncertainty`."""
    return _at(bound, last_place(uncertainty), ROUND_CEILING)


def upwards(number: float, *, digits: int = DIGITS) -> str:
    """Return a positive bound with so many significant digits, rounded up."""
    exact = _decimal(number)
    place = exact.adjusted() - digits + 1
    rounded = exact.quantize(Decimal(1).scaleb(place), ROUND_UP)
    return _at(number, place + (rounded.adjusted() - exact.adjusted()), ROUND_UP)


def widening(factor: float) -> str:
    """Return a factor by which uncertainties were widened, rounded up; the same wherever told."""
    return upwards(factor, digits=3)


def plain(number: float) -> str:
    """Return a number that was given, not measured, without padding: 45, 21.3, 485.9."""
    return _plain(Decimal(f"{number:.6g}"))


def significant(number: float, *, digits: int = 3) -> str:
    """Return a number with so many significant digits, with a power of ten where it is far from 1.

    0.000123 becomes 1.23×10⁻⁴.
    """
    if number == 0:
        return "0"
    if not math.isfinite(number):
        return "∞" if number > 0 else "-∞" if number < 0 else "not a number"
    exponent = int(f"{number:.{digits - 1}e}".split("e")[1])
    if -4 < exponent < 6:
        return _at(number, exponent - digits + 1, ROUND_HALF_EVEN)
    mantissa = _at(number / 10.0**exponent, 1 - digits, ROUND_HALF_EVEN)
    return f"{mantissa}×10{str(exponent).translate(_SUPERSCRIPT)}"


def fixed(number: float, decimals: int) -> str:
    """Return a number with so many decimals, ties to even."""
    return _at(number, -decimals, ROUND_HALF_EVEN)


def percent_down(probability: float) -> str:
    """Return a probability in per cent, one decimal, rounded down: 99.99 % is not certainty."""
    return _at(100 * probability, -1, ROUND_FLOOR)
