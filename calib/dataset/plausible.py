"""Numbers that are no measurement of this kind of rig: out of range, or in another unit.

A suspicion names the unit that the values look like. Each bound is far outside what a rig with two
cameras side by side can yield, so that nobody has to argue with it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from calib.core.arrays import FloatArray
from calib.dataset.cells import Cells
from calib.dataset.conventions import ReadingConvention, better_convention

RADIANS_BELOW = 3.2
"""Readings below this are radians: as degrees, C2 would look straight at C1."""

SINGLE_SHARE = 0.15
"""Part of the readings up to which those out of range are slips of single rows."""

LARGEST_COTANGENT = 20.0
"""C2 within 3 degrees of looking straight at C1, or away from it: more likely an angle."""

LARGEST_NORMALISED = 5.0
"""79 degrees off the optical axis of C1: more likely pixels."""

SMALLEST_DEPTH_MM = 10.0
"""Depths of a whole table below this are metres: no lens focuses there."""

LARGEST_DEPTH_MM = 200_000.0
"""Depths of a whole table above this are micrometres: at 200 m the gaze angle tells nothing."""

DEPTH_RATIO = 200.0
"""A row this many times above or below the table's median depth has another unit."""

SMALLEST_LENGTH_MM = 3.0
"""Known lengths of a whole table below this are metres."""

LARGEST_ZERO_ERROR_RAD = float(np.deg2rad(20))
"""Encoder zero error that a reading may have; beyond it C1's ray and C2's gaze never meet."""


def check_normalised(cells: Cells, column: str, values: FloatArray) -> None:
    """Report normalised coordinates, shape (n,), that look like pixels."""
    pixels = {"x1c": "u1_px", "y1c": "v1_px"}[column]
    cells.report(
        np.abs(values) > LARGEST_NORMALISED,
        column,
        lambda i: f"{values[i]:g} looks like pixels, not a normalised coordinate (X / Z)",
        f"name the column {pixels}, or divide by the focal length",
    )


Guess: TypeAlias = Callable[[FloatArray], ReadingConvention | None]
"""Says what readings are that do not all lie within (0, 180), if it can."""


def check_angles(cells: Cells, degrees: FloatArray, outside: Guess = lambda _: None) -> FloatArray:
    """Report readings, deg, shape (n,), outside (0, 180), or that look like radians.

    Returns
    -------
    The readings; NaN all, where they follow another convention as a whole.
    """
    known = degrees[~np.isnan(degrees)]
    if len(known) and np.all((known > 0) & (known < RADIANS_BELOW)):
        cells.suspect(
            "alpha2_deg",
            f"all readings lie between {known.min():g} and {known.max():g}: radians?",
            "give them in degrees; C2 looks parallel to Z of C1 at 90",
        )
        return degrees
    beyond = (known <= 0) | (known >= 180)
    if beyond.sum() > SINGLE_SHARE * len(known) and (guess := outside(degrees)) is not None:
        cells.suspect(
            "alpha2_deg",
            f"{beyond.sum()} of {len(known)} readings, {known.min():g} to {known.max():g}, are "
            f"outside (0, 180): {guess.what}",
            f"{guess.remedy} (C2 looks parallel to Z of C1 at 90)",
        )
        return np.full_like(degrees, np.nan)
    cells.report(
        (degrees > 0) & (degrees < RADIANS_BELOW),
        "alpha2_deg",
        lambda i: f"{degrees[i]:g} among readings in degrees: radians?",
        "give it in degrees; C2 looks parallel to Z of C1 at 90",
    )
    cells.report(
        (degrees <= 0) | (degrees >= 180),
        "alpha2_deg",
        lambda i: f"{degrees[i]:g} is outside (0, 180)",
        "count from -X of C1 towards +Z: C2 looks parallel to Z of C1 at 90",
    )
    return degrees


def check_cotangents(cells: Cells, values: FloatArray) -> None:
    """Report cotangents, shape (n,), that look like angles."""
    cells.report(
        np.abs(values) > LARGEST_COTANGENT,
        "ctan_alpha2",
        lambda i: f"{values[i]:g} looks like an angle, not a cotangent",
        "name the column alpha2_deg, or give the cotangent: 0 at 90 degrees",
    )


def check_sight_lines(
    cells: Cells, x1c: FloatArray, alpha2: FloatArray, z_mm: FloatArray, *, is_left: bool
) -> None:
    """Report rows whose lines of sight part, so that the target would lie behind the cameras.

    Parameters
    ----------
    x1c, z_mm
        Shape (n,); depths tell whether the whole table follows another convention.
    alpha2
        Readings, rad, shape (n,).
    is_left
        Whether C2 stands at -X of C1, where all is as in a mirror.
    """
    meant = better_convention(np.rad2deg(alpha2), x1c, z_mm, is_left=is_left)
    if is_left:
        x1c, alpha2 = -x1c, np.pi - alpha2
    towards, other = ("above", "right") if is_left else ("below", "left")
    # In front of C1 they meet where x1c + cot(alpha) > 0, that is alpha < 90 deg + atan(x1c).
    parted = alpha2 - (np.pi / 2 + np.arctan(x1c))
    behind = (parted > LARGEST_ZERO_ERROR_RAD) & (alpha2 < np.pi)
    if behind.any() and meant is not None:
        where = f"the lines of sight of {behind.sum()} of {len(cells)} rows part"
        column = "alpha2_deg" if "alpha2_deg" in cells else "ctan_alpha2"
        cells.suspect(column, f"{where}: {meant[0]}", meant[1])
        return
    cells.report(
        behind,
        None,
        lambda i: (
            f"the lines of sight part by {np.rad2deg(parted[i]):.0f} degrees: "
            "the target would lie behind the cameras"
        ),
        f"check the sign of x1c (X to the right) and of alpha2 ({towards} 90 C2 looks towards C1); "
        f'if C2 stands on the {other} of C1, write c2 = "{other}" in [rig]',
    )


def check_depths(cells: Cells, column: str, values: FloatArray) -> None:
    """Report depths, mm, shape (n,), that are not positive, or look like another unit."""
    cells.report(
        values <= 0,
        column,
        lambda i: f"{values[i]:g} is not in front of C1",
        "give a depth above 0",
    )
    known = values[values > 0]
    if not len(known):
        return
    for wrong, unit in (
        (np.all(known < SMALLEST_DEPTH_MM), "metres"),
        (np.all(known > LARGEST_DEPTH_MM), "micrometres"),
    ):
        if wrong:
            extent = f"all depths lie between {known.min():g} and {known.max():g}"
            cells.suspect(column, f"{extent}: {unit}?", "give them in millimetres")
            return
    # Of an even count the median is a mean, which the largest numbers overflow.
    median = float(np.quantile(known, 0.5, method="lower"))
    cells.report(
        (values > 0) & ((values < median / DEPTH_RATIO) | (values / DEPTH_RATIO > median)),
        column,
        lambda i: f"{values[i]:g} beside a median of {median:g}: another unit?",
        "give all depths in millimetres",
    )


def check_lengths(cells: Cells, length: FloatArray, u_length: FloatArray) -> None:
    """Report known lengths, mm, shape (n,), and uncertainties that are out of range."""
    cells.report(
        length <= 0,
        "length_mm",
        lambda i: f"{length[i]:g} is not positive",
        "give a length above 0",
    )
    cells.report(
        u_length < 0, "u_length_mm", lambda i: f"{u_length[i]:g} is negative", "give it positive"
    )
    known = length[length > 0]
    if len(known) and np.all(known < SMALLEST_LENGTH_MM):
        cells.suspect(
            "length_mm", f"no length exceeds {known.max():g}: metres?", "give them in millimetres"
        )
