"""Which convention a table follows: where its readings count from, in what unit, which way round.

Rows that have coordinate, reading and depth tell it themselves. In a rig whose axis stands at
(L, 0, 0) and whose encoder has a small zero error d, x1c + cot(alpha2 + d) = L / z: linear in two
unknowns, whatever the convention. The right one fits by far better than the others.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray

FEWEST_ROWS = 5
"""Two are used up by the unknowns; three more seldom agree by chance with a wrong convention."""

DECISIVE_RATIO = 3.0
"""Root mean square misfits of two conventions, of which the smaller then counts. An axis 20 mm off
or a quarter of a degree of backlash leaves a few milliradians, a wrong convention tens of them."""

LARGEST_ZERO_RAD = float(np.deg2rad(20.0))
"""Zero error that a rig may have; conventions that need a larger one are not what was meant."""

SPREAD = 1e-3
"""Smallest part of one unknown's effect that the other may not imitate, for the two to be found."""


@dataclass(frozen=True)
class ReadingConvention:
    """How a reading r becomes alpha2_deg: offset + factor * r.

    Parameters
    ----------
    offset, factor
        In degrees, and in degrees a unit of the reading.
    what
        What the readings then are.
    remedy
        What to write instead.
    """

    offset: float
    factor: float
    what: str
    remedy: str

    def of(self, reading: FloatArray) -> FloatArray:
        """Return alpha2, deg."""
        return self.offset + self.factor * reading


@dataclass(frozen=True)
class Misfit:
    """How rows fit a convention.

    Parameters
    ----------
    rms_rad
        Root mean square of what is left.
    baseline_mm, zero_rad
        The two unknowns.
    """

    rms_rad: float
    baseline_mm: float
    zero_rad: float


AS_READ = ReadingConvention(0.0, 1.0, "degrees as they should be", "leave them")
REVERSED = ReadingConvention(
    180.0, -1.0, "the encoder counts the wrong way round", "give 180 - alpha2_deg instead"
)
_MRAD = float(np.rad2deg(1e-3))

GON = ReadingConvention(0.0, 0.9, "gon", "give 0.9 times the reading, in degrees")


def misfit(x1c: FloatArray, alpha2_deg: FloatArray, z_mm: FloatArray) -> Misfit | None:
    """Return how rows fit; None if they are too few or do not tell the two unknowns apart.

    Parameters
    ----------
    x1c, alpha2_deg, z_mm
        Shape (n,); rows with a NaN are left out.
    """
    known = np.isfinite(x1c) & np.isfinite(alpha2_deg) & (z_mm > 0)
    known &= (alpha2_deg > 0) & (alpha2_deg < 180)
    if known.sum() < FEWEST_ROWS:
        return None
    alpha, x, z = np.deg2rad(alpha2_deg[known]), x1c[known], z_mm[known]
    # The condition times sin²: what is left is an angle of the gaze.
    sin2 = np.sin(alpha) ** 2
    design = np.column_stack([sin2 / z * z.min(), np.ones_like(z)])
    wanted = sin2 * x + np.sin(alpha) * np.cos(alpha)
    unknown, _, _, singular = np.linalg.lstsq(design, wanted, rcond=None)
    if singular[1] < SPREAD * singular[0]:
        return None
    left = wanted - design @ unknown
    return Misfit(
        rms_rad=float(np.sqrt(left @ left / (len(z) - 2))),
        baseline_mm=float(unknown[0] * z.min()),
        zero_rad=float(unknown[1]),
    )


def readings_outside(
    reading: FloatArray,
    x1c: FloatArray,
    z_mm: FloatArray,
    *,
    step_deg: float | None,
    is_left: bool,
) -> ReadingConvention | None:
    """Return what readings are that do not all lie within (0, 180); None if nothing tells.

    Parameters
    ----------
    reading, x1c, z_mm
        Shape (n,), NaN where a row has none.
    step_deg
        One count of the encoder, if it is stated.
    is_left
        Whether C2 stands at -X of C1.
    """
    known = reading[np.isfinite(reading)]
    possible = [
        one
        for one in _candidates(known, step_deg)
        if np.all((one.of(known) > 0) & (one.of(known) < 180))
    ]
    fits = [(one, misfit(x1c, one.of(reading), z_mm)) for one in possible]
    sound = [
        (found.rms_rad, i)
        for i, (_, found) in enumerate(fits)
        if found is not None
        and abs(found.zero_rad) < LARGEST_ZERO_RAD
        and (found.baseline_mm < 0) is is_left
    ]
    sound.sort()
    if sound and (len(sound) == 1 or sound[0][0] * DECISIVE_RATIO < sound[1][0]):
        return possible[sound[0][1]]
    return _by_range(known, possible)


def _candidates(known: FloatArray, step_deg: float | None) -> Iterator[ReadingConvention]:
    """Yield what readings may be that do not lie within (0, 180)."""
    most = float(np.abs(known).max(initial=0.0))
    if most < 90 and known.min() < 0:
        yield ReadingConvention(90, 1, "they count about 0", "add 90 to each")
        yield ReadingConvention(
            90, -1, "they count about 0, the wrong way round", "give 90 less the reading"
        )
    if 180 <= most < 360 and known.min() > 0:
        for start in (90.0, 180.0):
            yield ReadingConvention(
                -start, 1, f"they count from {start:g} degrees further", f"take {start:g} from each"
            )
            yield ReadingConvention(
                180 + start, -1, "they count the wrong way round, from another zero",
                f"give {180 + start:g} less the reading",
            )  # fmt: skip
    if most > 360:
        yield ReadingConvention(0, _MRAD, "milliradians", "give 0.0572958 times the reading")
    if step_deg is None or most < 180 or np.any(known != np.round(known)):
        return
    counts = "they are counts of the encoder"
    yield ReadingConvention(0, step_deg, counts, f"give them times resolution_deg, {step_deg:g}")
    yield ReadingConvention(
        90, step_deg, f"{counts} about 0", f"give 90 plus them times resolution_deg, {step_deg:g}"
    )
    turned = f"{counts}, which counts the wrong way round"
    yield ReadingConvention(
        180, -step_deg, turned, f"give 180 less them times resolution_deg, {step_deg:g}"
    )
    yield ReadingConvention(
        90, -step_deg, f"{turned}, about 0",
        f"give 90 less them times resolution_deg, {step_deg:g}",
    )  # fmt: skip


def _by_range(known: FloatArray, possible: list[ReadingConvention]) -> ReadingConvention | None:
    """Return what readings look like where no depths tell."""
    if len(possible) == 1:
        return possible[0]
    most = float(np.abs(known).max(initial=0.0))
    if most < 90 and known.min() < 0:
        return ReadingConvention(
            90, 1, "they count about 0",
            "add 90 to each, or give 90 less each where it counts the other way round",
        )  # fmt: skip
    if most > 360 and np.all(known == np.round(known)):
        return ReadingConvention(
            0, 1, "they are counts of the encoder",
            "give them times resolution_deg, from the zero of the frame (at 90 C2 looks parallel "
            "to Z of C1)",
        )  # fmt: skip
    return None


def better_convention(
    reading: FloatArray, x1c: FloatArray, z_mm: FloatArray, *, is_left: bool
) -> tuple[str, str] | None:
    """Return what readings within (0, 180) look like, and the remedy; None if they are right.

    Parameters
    ----------
    reading
        alpha2, deg, shape (n,).
    x1c, z_mm
        Shape (n,).
    is_left
        Whether C2 stands at -X of C1.
    """
    read = misfit(x1c, reading, z_mm)
    if read is None:
        return None
    for one in (REVERSED, GON):
        found = misfit(x1c, one.of(reading), z_mm)
        if found is None or abs(found.zero_rad) > LARGEST_ZERO_RAD:
            continue
        if found.rms_rad * DECISIVE_RATIO < read.rms_rad:
            figures = (
                f" (rows then fit to {1000 * found.rms_rad:.2g} mrad, as read to "
                f"{1000 * read.rms_rad:.2g})"
            )
            if (found.baseline_mm < 0) is is_left:
                return one.what + figures, one.remedy
            if one is REVERSED:
                return (
                    "x1c has the wrong sign" + figures,
                    "X of C1 counts to the right: are C1's pictures mirrored? Or C2 stands on the "
                    "other side of C1 ([rig] c2) and its encoder counts the wrong way round",
                )
    return None
