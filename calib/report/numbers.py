"""Numbers as the report prints them: rounded by `calib.uncertainty.format`, with a real minus."""

from __future__ import annotations

import math

import numpy as np
from markupsafe import Markup

from calib.core.arrays import FloatArray
from calib.fit.priors import NOISE_SCALE
from calib.geometry.parameters import INDEX, PARAMETERS
from calib.report.blocks import EMPTY, Cell, number
from calib.uncertainty.format import (
    SHOWN,
    at_place,
    fixed,
    interval,
    significant,
    upwards,
    with_uncertainty,
)

MINUS = "−"

EFFECTIVE = "effective_baseline_mm"


def signed(text: str) -> str:
    """Return the text of a number with a minus sign in place of the hyphen."""
    return text.replace("-", MINUS)


def decimals(value: float | None, count: int, *, mark: str = "") -> Cell:
    """Return a cell with a fixed number of decimals."""
    if value is None or math.isnan(value):
        return EMPTY
    if math.isinf(value):
        return number(signed(significant(value)), value, mark=mark)
    return number(signed(fixed(value, count)), value, mark=mark)


def digits(value: float | None, count: int = 3, *, mark: str = "") -> Cell:
    """Return a cell with a number of significant digits."""
    if value is None or math.isnan(value):
        return EMPTY
    return number(signed(significant(value, digits=count)), value, mark=mark)


def percent(value: float | None) -> Cell:
    """Return a cell with a ratio in per cent, two significant digits."""
    return EMPTY if value is None or math.isnan(value) else digits(100 * value, 2)


def places(values: FloatArray) -> int:
    """Return the decimals with which a column shows two digits of its middling entry."""
    size = np.abs(values[np.isfinite(values) & (values != 0)])
    if not len(size):
        return 1
    return int(np.clip(1 - np.floor(np.log10(np.median(size))), 0, MOST_PLACES))


MOST_PLACES = 6


def plus_minus(value: float, u: float, *, factor: float = 1.0) -> str:
    """Return a value with its standard uncertainty, both rounded alike."""
    value, u = factor * value, factor * u
    if not (math.isfinite(u) and u > 0):
        return signed(significant(value, digits=4))
    rounded = with_uncertainty(value, u)
    return f"{signed(rounded.value)} ± {rounded.uncertainty}"


def with_sign(value: float) -> str:
    """Return two significant digits of a deviation, with its sign also where that is a plus."""
    return ("+" if value > 0 else "") + signed(significant(value, digits=2))


def estimate(value: float, u: float, *, factor: float = 1.0, mark: str = "") -> Cell:
    """Return a cell with value and standard uncertainty."""
    return number(plus_minus(value, u, factor=factor), factor * value, mark=mark)


def given(value: float, u: float) -> Cell:
    """Return a cell with a number beside one of standard uncertainty `u`, to the same place.

    What was given has digits enough for the difference of the two to be checked by hand.
    """
    if not (math.isfinite(value) and math.isfinite(u) and u > 0):
        return decimals(value, 1)
    return number(signed(at_place(value, uncertainty=u)), value)


def rounded_up(bound: float) -> Cell:
    """Return a cell with two significant digits of a bound, rounded up."""
    if not (math.isfinite(bound) and bound > 0):
        return digits(bound, 2)
    return number(upwards(bound), bound)


def bounds(low: float, high: float, u: float, *, factor: float = 1.0) -> Cell:
    """Return a cell with an interval, rounded outwards to the place of `u`."""
    low, high, u = factor * low, factor * high, factor * u
    if not (math.isfinite(u) and u > 0):
        text = f"{signed(significant(low))} to {signed(significant(high))}"
    elif math.isinf(high):
        text = f"{signed(interval(low, low, uncertainty=u)[0])} to ∞"
    else:
        ends = interval(low, high, uncertainty=u)
        text = f"{signed(ends[0])} to {signed(ends[1])}"
    return number(text, low)


def unit(name: str) -> str:
    """Return the printed unit of a parameter; empty for pure numbers."""
    printed = SHOWN[_internal_unit(name)].unit
    return "" if printed == "1" else printed


def factor(name: str) -> float:
    """Return the factor from a parameter's internal unit to the printed one."""
    return SHOWN[_internal_unit(name)].factor


def _internal_unit(name: str) -> str:
    if name == EFFECTIVE:
        return "mm"
    return "1" if name == NOISE_SCALE else PARAMETERS[INDEX[name]].unit


def symbol(name: str) -> Markup:
    """Return the symbol of a parameter as HTML."""
    if name == EFFECTIVE:
        return Markup("{} + {}").format(symbol("baseline_mm"), symbol("eccentricity_mm"))
    if name == NOISE_SCALE:
        return Markup("ln <i>s</i>")
    stem, index = _split(PARAMETERS[INDEX[name]].symbol)
    return (
        Markup("<i>{}</i><sub>{}</sub>").format(stem, index)
        if index
        else Markup("<i>{}</i>").format(stem)
    )


def plain_symbol(name: str) -> str:
    """Return the symbol of a parameter for figures, in matplotlib's mathematics."""
    if name == EFFECTIVE:
        return f"{plain_symbol('baseline_mm')} + {plain_symbol('eccentricity_mm')}"
    if name == NOISE_SCALE:
        return r"$\ln\,s$"
    stem, index = _split(PARAMETERS[INDEX[name]].symbol)
    return f"${stem}_{{{index}}}$" if index else f"${stem}$"


def _split(text: str) -> tuple[str, str]:
    """Return stem and index of a symbol: L_b, δ2, e."""
    stem, _, index = text.partition("_")
    if not index and len(stem) > 1 and stem[-1].isdigit():
        return stem[:-1], stem[-1]
    return stem, index


def meaning(name: str) -> str:
    """Return what a parameter is, in a phrase."""
    if name == EFFECTIVE:
        return "baseline seen at 90°"
    if name == NOISE_SCALE:
        return "logarithm of the noise scale"
    return PARAMETERS[INDEX[name]].meaning
