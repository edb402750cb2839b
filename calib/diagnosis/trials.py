"""What a hypothesis does to rows: the errors that it adds, and where it may have struck."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.diagnosis.session import HistoryArrays
from calib.fit.noise import outlier_limit
from calib.geometry.plane import OBSERVABLE, Gaze
from calib.rows.observations import Observations

DEG = float(np.deg2rad(1.0))
GON = 0.9 * DEG

TYPICAL_DEPTH_SHARE = 0.03
"""By this share reference depths are wrong that belong to others, as a rule."""

LEAST_RUN = 3
"""Rows on either side of a change: an outlier or two are no change."""

KNOTS = 60
"""Places at most where a level may change twice: their pairs are 1,770."""

WORST = 4
"""Rows that may have been exchanged are among so many that disagree most."""

STRAY = 3
"""Outliers at most: among more some pair looks exchanged by chance."""


@dataclass(frozen=True)
class Search:
    """An error of one observable that struck at one of several places.

    Parameters
    ----------
    column
        Of `OBSERVABLE`.
    patterns
        Error of each row per unit of the parameter, shape (n, m).
    at
        Name of each place, length m.
    """

    column: int
    patterns: FloatArray
    at: tuple[str | None, ...]

    def loadings(self, place: int) -> FloatArray:
        """Return the errors of one place, shape (n, 5, 1)."""
        return on_column(self.column, self.patterns[:, place : place + 1])


@dataclass(frozen=True)
class Loaded:
    """Errors per unit of each parameter, shape (n, 5, q)."""

    loadings: FloatArray


@dataclass(frozen=True)
class Periodic:
    """Errors of readings that repeat with the angle where the axis truly stands.

    Parameters
    ----------
    period_rad
        Of the errors.
    """

    period_rad: float

    def loadings(self, gaze: Gaze) -> FloatArray:
        """Return the errors per unit of cosine and sine at true gazes, shape (n, 5, 2)."""
        phase = 2 * np.pi * gaze.alpha2 / self.period_rad
        return on_column(OBSERVABLE.alpha2, np.stack([np.cos(phase), np.sin(phase)], axis=1))


@dataclass(frozen=True)
class Distorted:
    """Errors of C1's coordinates by a cubic distortion of where the target truly is."""

    def loadings(self, gaze: Gaze) -> FloatArray:
        """Return the errors per unit of k1 at true gazes, shape (n, 5, 1)."""
        square = gaze.x1c**2 + gaze.y1c**2
        return _of_c1(gaze.x1c * square, gaze.y1c * square)


@dataclass(frozen=True)
class TwoSided:
    """An error by which each row is off to one of two sides, nobody knows which.

    Rows in two classes nobody stated can be made of any few that are off, whatever of them is.

    Parameters
    ----------
    loadings
        As of the upper side, shape (n, 5, 1).
    rival
        Of another error of two sides, shape (n, 5, 1): evidence is counted against it, too.
    rival_std
        Standard deviation of its prior.
    """

    loadings: FloatArray
    rival: FloatArray
    rival_std: float


@dataclass(frozen=True)
class Mended:
    """Rows without a mistake that has no size: exchanged, mirrored, in another unit.

    Parameters
    ----------
    rows
        As they should have been.
    at
        Which rows.
    share
        Error of each observable where the mistake is as supposed, shape (n, 5, 1): the estimate of
        its size should then come out as 1. None where there is no such thing.
    anew
        Whether the fit is to be found anew, as the mended rows are far from the others.
    exchanged
        Places of rows that stood in each other's place.
    """

    rows: Observations
    at: str | None
    share: FloatArray | None = None
    anew: bool = False
    exchanged: tuple[int, ...] = ()


Trial = Search | Loaded | Periodic | Distorted | TwoSided | Mended


@dataclass(frozen=True)
class Looked:
    """Rows with their session and residuals, as hypotheses look at them.

    Parameters
    ----------
    standardised
        Residuals of the fit over their stated uncertainty, shape (n,).
    """

    rows: Observations
    session: HistoryArrays
    standardised: FloatArray


Trials = Callable[[Looked], tuple[Trial, ...]]


def on_column(column: int, patterns: FloatArray) -> FloatArray:
    """Return loadings, shape (n, 5, q), of errors of one observable, shape (n, q)."""
    loadings = np.zeros((len(patterns), len(OBSERVABLE), patterns.shape[1]))
    loadings[:, column] = patterns
    return loadings


def _changes(count: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.arange(LEAST_RUN, count - LEAST_RUN + 1)


def reading_step(seen: Looked) -> tuple[Trial, ...]:
    """Let rows before a place read lower than the rig does now."""
    rank, changes = seen.session.rank, _changes(len(seen.rows))
    if not len(changes):
        return ()
    order = seen.session.in_order
    at = tuple(seen.session.ids[order[k]] for k in changes)
    return (Search(OBSERVABLE.alpha2, np.where(rank[:, None] < changes, -1.0, 0.0), at),)


def rehomed(seen: Looked) -> tuple[Trial, ...]:
    """Let rows between two places read higher than those before and after them."""
    rank, changes = seen.session.rank, _changes(len(seen.rows))
    changes = np.unique(np.linspace(changes[0], changes[-1], KNOTS).astype(int)) if len(
        changes
    ) > KNOTS else changes  # fmt: skip
    pairs = [(a, b) for a in changes for b in changes if b - a >= LEAST_RUN]
    if not pairs:
        return ()
    first, last = np.array(pairs).T
    order, ids = seen.session.in_order, seen.session.ids
    at = tuple(f"{ids[order[a]]} to {ids[order[b - 1]]}" for a, b in pairs)
    inside = (rank[:, None] >= first) & (rank[:, None] < last)
    return (Search(OBSERVABLE.alpha2, np.where(inside, 1.0, 0.0), at),)


def reading_drift(seen: Looked) -> tuple[Trial, ...]:
    """Let readings move away, at a constant rate, from what they are at the end."""
    return (Loaded(on_column(OBSERVABLE.alpha2, seen.session.progress[:, None] - 1)),)


def backlash(seen: Looked) -> tuple[Trial, ...]:
    """Let readings differ by the side of approach: as stated, by the last reading, or unknown."""
    session = seen.session
    if len(session.approach):
        # Of a rig that comes to rest upwards, as it should from now on.
        return (Loaded(on_column(OBSERVABLE.alpha2, (session.approach[:, None] - 1) / 2)),)
    order = session.in_order
    moved = np.sign(np.diff(seen.rows.alpha2_rad[order]))
    side = np.zeros(len(session))
    side[order[1:]] = moved
    by_order = Loaded(on_column(OBSERVABLE.alpha2, side[:, None] / 2))
    either = TwoSided(
        on_column(OBSERVABLE.alpha2, np.full((len(session), 1), 0.5)),
        rival=on_column(OBSERVABLE.z, 0.5 * seen.rows.z_mm[:, None]),
        rival_std=TYPICAL_DEPTH_SHARE,
    )
    return (by_order, either)


def microstep(seen: Looked) -> tuple[Trial, ...]:
    """Let readings err with the period of a full step."""
    session = seen.session
    full = session.full_step_rad
    periods = [full] if full is not None else [session.step_rad * 2**k for k in range(2, 9)]
    found: list[Trial] = []
    for period in periods:
        trial = Periodic(period)
        waves = trial.loadings(seen.rows.gaze)[:, OBSERVABLE.alpha2]
        varies = np.linalg.svd(waves - waves.mean(axis=0), compute_uv=False)[-1]
        if period < 8 * DEG and varies > 0.1 * np.sqrt(len(waves)):
            found.append(trial)
    return tuple(found)


def twice_per_turn(seen: Looked) -> tuple[Trial, ...]:
    """Let readings err twice per turn."""
    alpha = seen.rows.alpha2_rad
    waves = np.stack([np.cos(2 * alpha), np.sin(2 * alpha)], axis=1)
    return (Loaded(on_column(OBSERVABLE.alpha2, waves)),)


def _of_c1(by_x: FloatArray, by_y: FloatArray) -> FloatArray:
    loadings = np.zeros((len(by_x), len(OBSERVABLE), 1))
    loadings[:, OBSERVABLE.x1c, 0], loadings[:, OBSERVABLE.y1c, 0] = by_x, by_y
    return loadings


def distortion(_: Looked) -> tuple[Trial, ...]:
    """Take coordinates for those of a lens with a cubic distortion."""
    return (Distorted(),)


def principal_point(seen: Looked) -> tuple[Trial, ...]:
    """Count x1c from a point beside the principal point."""
    return (Loaded(_of_c1(np.ones(len(seen.rows)), np.zeros(len(seen.rows)))),)


def focal_length(seen: Looked) -> tuple[Trial, ...]:
    """Let coordinates be too large by a factor."""
    return (Loaded(_of_c1(seen.rows.x1c, seen.rows.y1c)),)


def by_references_alone(_: Looked) -> tuple[Trial, ...]:
    """Try nothing on the rows: only independent references show it."""
    return ()


def range_not_depth(seen: Looked) -> tuple[Trial, ...]:
    """Take reference depths for distances along the ray."""
    rows = seen.rows
    cosine = 1 / np.sqrt(1 + rows.x1c**2 + rows.y1c**2)
    share = on_column(OBSERVABLE.z, (rows.z_mm * (1 - cosine))[:, None])
    return (Mended(replace(rows, z_mm=rows.z_mm * cosine), None, share),)


def reference_offset(seen: Looked) -> tuple[Trial, ...]:
    """Count reference depths from a place ahead of C1's optical centre."""
    return (Loaded(on_column(OBSERVABLE.z, np.full((len(seen.rows), 1), -1.0))),)


def _grouped(seen: Looked) -> dict[str, list[int]]:
    """Return rows by group, if some groups have several rows."""
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(seen.session.groups):
        groups.setdefault(name, []).append(i)
    return groups if max(map(len, groups.values())) > 1 and len(groups) > LEAST_RUN else {}


def _depth_limits(seen: Looked) -> FloatArray:
    return np.quantile(seen.rows.z_mm, [1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4])


def bias_near(seen: Looked) -> tuple[Trial, ...]:
    """Let reference depths of near groups be off by a length."""
    limits = _depth_limits(seen)[:3]
    if not _grouped(seen):
        return ()
    patterns = np.where(seen.rows.z_mm[:, None] <= limits, 1.0, 0.0)
    return (Search(OBSERVABLE.z, patterns, tuple(f"up to {z:.0f} mm" for z in limits)),)


def bias_far(seen: Looked) -> tuple[Trial, ...]:
    """Let reference depths of far groups be off by a factor."""
    limits = _depth_limits(seen)[2:]
    if not _grouped(seen):
        return ()
    z = seen.rows.z_mm[:, None]
    return (
        Search(
            OBSERVABLE.z, np.where(z >= limits, z, 0.0), tuple(f"from {f:.0f} mm" for f in limits)
        ),
    )


def group_reference(seen: Looked) -> tuple[Trial, ...]:
    """Let the reference depth of one group be off."""
    several = {name: rows for name, rows in _grouped(seen).items() if len(rows) > 1}
    if not several:
        return ()
    patterns = np.zeros((len(seen.rows), len(several)))
    for j, rows in enumerate(several.values()):
        patterns[rows, j] = 1.0
    return (Search(OBSERVABLE.z, patterns, tuple(several)),)


def x_mirrored(seen: Looked) -> tuple[Trial, ...]:
    """Give x1c the other sign."""
    return (Mended(replace(seen.rows, x1c=-seen.rows.x1c), None, anew=True),)


def y_mirrored(seen: Looked) -> tuple[Trial, ...]:
    """Give y1c the other sign, which a level axis does not show."""
    if not seen.rows.has_height:
        return ()
    return (Mended(replace(seen.rows, y1c=-seen.rows.y1c), None, anew=True),)


def in_unit(seen: Looked) -> tuple[Trial, ...]:
    """Take readings for gon or rad, or some depths for another unit."""
    rows = seen.rows
    found: list[Trial] = []
    for unit, size in (("gon", 0.9), ("rad", 1 / DEG)):
        alpha = rows.alpha2_rad * size
        if np.all((alpha > 0) & (alpha < np.pi)):
            at = f"alpha2 in {unit}"
            found.append(Mended(replace(rows, alpha2_rad=alpha), at, anew=True))
    return (*found, *_depths_in_unit(seen))


def _depths_in_unit(seen: Looked) -> Iterator[Trial]:
    """Yield rows with some depths converted: those that disagree, and those far from the rest."""
    rows, size = seen.rows, np.abs(seen.standardised)
    disagrees = size > 5 * np.median(size)
    away = np.log(rows.z_mm / float(np.median(rows.z_mm)))
    for factor in (10.0, 25.4, 1000.0):
        for times in (factor, 1 / factor):
            nearer = np.abs(away + np.log(times)) < np.abs(away)
            for some in (disagrees & nearer, np.abs(away + np.log(times)) < np.abs(away) / 2):
                if 0 < some.sum() < len(rows) / 2:
                    z = np.where(some, rows.z_mm * times, rows.z_mm)
                    names = ", ".join(np.array(rows.ids)[some][:WORST])
                    at = f"z_mm times {times:.4g} in rows {names}"
                    yield Mended(replace(rows, z_mm=z), at, anew=True)


def exchanged(seen: Looked) -> tuple[Trial, ...]:
    """Exchange reading or reference depth of two rows."""
    rows = seen.rows
    size = np.abs(seen.standardised)
    worst = np.argsort(-size, kind="stable")[:WORST]
    if np.sum(size > outlier_limit(len(rows)) * 1.5 * np.median(size)) > STRAY:
        return ()
    found: list[Trial] = []
    for i, a in enumerate(worst):
        for b in worst[:i]:
            pair, swapped = [int(b), int(a)], [int(a), int(b)]
            names = " and ".join(rows.ids[k] for k in sorted(pair))
            z, alpha = rows.z_mm.copy(), rows.alpha2_rad.copy()
            z[pair], alpha[pair] = z[swapped], alpha[swapped]
            found += [
                Mended(replace(rows, z_mm=z), f"z_mm of {names}", exchanged=tuple(pair)),
                Mended(
                    replace(rows, alpha2_rad=alpha), f"reading of {names}", exchanged=tuple(pair)
                ),
            ]
    return tuple(found)
