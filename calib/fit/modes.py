"""A search for modes of a density that a sample of it has left out.

Chains and importance sample both start from one fit. If the density has a second mode many
standard deviations away, neither meets it, both agree, and R-hat is 1. So points scattered 3 to
1000 standard deviations around the sample climb the density, all at once, by Newton steps that
follow the absolute curvature. A start needs no luck but to be past the saddle. What the search
cannot find is a mode so narrow that hardly any start climbs it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.fit.importance import ImportanceSample, Proposal

Density = Callable[[FloatArray], FloatArray]
"""Maps points, shape (m, d), to log densities, shape (m,), up to a constant."""

SPREADS = (3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Standard deviations of the starts, in those of the sample."""

STARTS_A_SPREAD = 8
"""A mode as wide as the first and D off is climbed from wherever the component towards it exceeds
D / 2: from a start of spread D with probability 0.31, of spread 3 D with 0.43. All starts of these
two spreads and wider ones miss it with probability 6e-4 up to D = 300, and 0.05 at 1000."""

MAXIMUM_CLIMBS = 100
"""Newton steps of a start; nearly all end within 20."""

DIFFERENCE = 0.02
"""Distance of the points that tell derivatives, in standard deviations of the sample."""

LONGEST_STEP = 1e3
"""Longest step, in the same."""

FLAT = 1e-6
"""Expected gain of a step, in nats, at which a start has arrived."""

FAR = 6.0
"""Distance from the sample's mean, in its standard deviations, from which on a mode counts as left
out: chains cross a saddle three standard deviations off by themselves."""

NEGLIGIBLE_SHARE = 1e-3
"""Share of the whole below which a mode changes no interval, and the mean by a thousandth of its
distance."""


@dataclass(frozen=True)
class LeftOutMode:
    """A mode that a sample has left out.

    Parameters
    ----------
    place
        Where, shape (d,).
    share
        Its share of the whole, by the curvatures at both modes.
    distance
        From the sample's mean, in standard deviations of the sample.
    """

    place: FloatArray
    share: float
    distance: float


@dataclass(frozen=True)
class _Tops:
    """Where climbs have ended, shape (k, d), and the logarithm of each mode's integral, (k,)."""

    places: FloatArray
    log_mass: FloatArray


def find_left_out_mode(
    target: Density,
    sample: ImportanceSample,
    rng: np.random.Generator,
    *,
    widening: float = 1.0,
    near: FloatArray | None = None,
) -> LeftOutMode | None:
    """Return the heaviest mode that a sample of the density has left out, None if there is none.

    Parameters
    ----------
    widening
        Factor on the sample's standard deviations, where `target` is flatter than the density
        sampled, as that of some of the rows is.
    near
        A point near a suspected mode, shape (d,), to climb from instead of scattered ones.
    """
    try:
        around = Proposal.around(sample.mean, widening**2 * sample.covariance)
    except np.linalg.LinAlgError:
        return None
    d = len(around.centre)

    def white(u: FloatArray) -> FloatArray:
        with np.errstate(over="ignore", invalid="ignore"):
            density = target(around.centre + u @ around.factor.T)
        known: FloatArray = np.where(np.isnan(density), -np.inf, density)
        return known

    if near is None:
        scale = np.repeat(SPREADS, STARTS_A_SPREAD)[:, None]
        starts = scale * rng.standard_normal((len(scale), d))
    else:
        starts = (np.linalg.inv(around.factor) @ (near - around.centre))[None]
    tops = _climb(white, np.concatenate([np.zeros((1, d)), starts]))
    if not len(tops.places):
        return None
    distance = np.sqrt((tops.places**2).sum(axis=1))
    first = tops.log_mass[distance <= FAR]
    own = first.max() if len(first) else _unit_mass(white, d)
    share = 1 / (1 + np.exp(np.clip(own - tops.log_mass, -700, 700))) * (distance > FAR)
    best = int(share.argmax())
    if share[best] < NEGLIGIBLE_SHARE:
        return None
    place = around.centre + around.factor @ tops.places[best]
    return LeftOutMode(place, float(share[best]), float(widening * distance[best]))


def _unit_mass(density: Density, d: int) -> float:
    """Return the log mass of a mode at the sample's mean, as wide as the sample."""
    return float(density(np.zeros((1, d)))[0] + d / 2 * np.log(2 * np.pi))


def _climb(density: Density, starts: FloatArray) -> _Tops:
    """Climb from all starts, shape (k, d), and return the tops that were reached."""
    place, height = starts.copy(), density(starts)
    damping = np.ones(len(place))
    active = np.isfinite(height)
    arrived = np.zeros(len(place), dtype=np.bool_)
    log_mass = np.full(len(place), -np.inf)
    for _ in range(MAXIMUM_CLIMBS):
        who = np.flatnonzero(active)
        if not len(who):
            break
        gradient, curvature = _derivatives(density, place[who], height[who])
        usable = np.isfinite(gradient).all(axis=1) & np.isfinite(curvature).all(axis=(1, 2))
        active[who[~usable]] = False
        who, gradient, curvature = who[usable], gradient[usable], curvature[usable]
        values, vectors = np.linalg.eigh(curvature)
        along = np.einsum("kji,kj->ki", vectors, gradient)
        done = _is_top(along, values)
        arrived[who[done]], active[who[done]] = True, False
        log_mass[who[done]] = (
            height[who[done]]
            + place.shape[1] / 2 * np.log(2 * np.pi)
            - 0.5 * np.log(-values[done]).sum(axis=1)
        )
        who, values, vectors, along = who[~done], values[~done], vectors[~done], along[~done]
        step = np.einsum("kij,kj->ki", vectors, along / (np.abs(values) + damping[who, None]))
        length = np.sqrt((step**2).sum(axis=1, keepdims=True))
        step *= np.minimum(1.0, LONGEST_STEP / np.maximum(length, 1e-300))
        there = density(place[who] + step) if len(who) else np.empty(0)
        better = there > height[who]
        place[who[better]] += step[better]
        height[who[better]] = there[better]
        damping[who] = np.where(better, damping[who] / 10, damping[who] * 10)
    return _Tops(place[arrived], log_mass[arrived])


def _is_top(along: FloatArray, values: FloatArray) -> BoolArray:
    """Return where curvature is downwards all around and a step would gain nothing, shape (k,).

    Parameters
    ----------
    along, values
        Gradient along each principal direction, and curvature, shape (k, d).
    """
    down = (values < 0).all(axis=1)
    gain = (along**2 / np.maximum(np.abs(values), 1e-300)).sum(axis=1)
    top: BoolArray = down & (gain < FLAT)
    return top


def _derivatives(
    density: Density, place: FloatArray, height: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return gradient, (k, d), and second derivatives, (k, d, d), by central differences."""
    k, d = place.shape
    unit = DIFFERENCE * np.eye(d)
    first, second = np.triu_indices(d, 1)
    offsets = np.concatenate([unit, -unit, unit[first] + unit[second], -unit[first] - unit[second]])
    values = density((place[:, None] + offsets).reshape(-1, d)).reshape(k, -1)
    with np.errstate(invalid="ignore"):
        plus, minus = values[:, :d], values[:, d : 2 * d]
        both = values[:, 2 * d : 2 * d + len(first)] + values[:, 2 * d + len(first) :]
        gradient = (plus - minus) / (2 * DIFFERENCE)
        own = plus + minus
        curvature = np.empty((k, d, d))
        curvature[:, range(d), range(d)] = own - 2 * height[:, None]
        mixed = (both - own[:, first] - own[:, second] + 2 * height[:, None]) / 2
        curvature[:, first, second] = curvature[:, second, first] = mixed
    return gradient, curvature / DIFFERENCE**2
