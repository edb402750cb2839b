"""Repeated gazes: rows that read one count at one place are one observation.

Whoever reads a resting rig ten times gets the same count ten times. Noise of the image averages
out, the rounding of the count does not, nor does the error of a reference taken once. Counted as
ten, such rows make everything look up to sqrt(10) times better than it is, and a model with
parameters enough to follow the rounding looks like the right one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.dataset.tables import GazeTable
from calib.geometry.plane import OBSERVABLE
from calib.rows.from_table import ImageObservations, Setup, observe
from calib.rows.observations import Observations

SAME_PLACE = 5.0
"""Neighbouring values that differ by no more standard uncertainties of a row are of one place.
Repeats leave no such gap, not even if their scatter is twice what is stated."""

WIDEST = 2.0
"""Widths, as `SAME_PLACE` sets them, that values of one place extend over: a target that moves on
by small steps is not at one place, and is divided by widths."""

SAME_DEPTH = 1e-3
"""Depths this near, relatively, are of one place in any case: they may be stated as exact."""

SAME_COUNT_RAD = 1e-9
"""Readings nearer than this are one count; decimals of a table leave less."""

BY_CHANCE = 0.01
"""Share of rows that is not worth a word: of 100,000 random gazes 0.2 % fall together."""

ROUNDS = 2
"""Once more than needed where the values lie apart: splitting by one quantity may open gaps in
another."""


def observe_gazes(
    table: GazeTable, setup: Setup, image_observations: ImageObservations | None
) -> Observations:
    """Return the calibration rows of a table, repeated gazes combined: `observe`, then `combine`.

    Raises
    ------
    InputError
        If a pixel of the table lies where the lens model has no ray.
    """
    return combine(observe(table, setup, image_observations))


def repetition_warning(table: GazeTable, rows: Observations) -> str | None:
    """Return what its reader should know of a table whose rows became fewer; None if hardly any."""
    if len(rows) >= (1 - BY_CHANCE) * len(table):
        return None
    return (
        f"{table.file}: {len(table)} rows repeat {len(rows)} gazes, the same reading at the same "
        "place. Repeats share the rounding of the reading, so each gaze counts once, at the mean "
        "of its rows; move the target a little between rows to gain more from them"
    )


def combine(rows: Observations) -> Observations:
    """Return rows of which no two read one count at one place.

    Repeats become one row at their mean, named after the first. Of its own errors those of the
    images are averaged; that of the reading is not, and that of the depth only if the repeats'
    depths differ, which shows that they were taken anew; what a depth shares with its group stays
    as it is. Without repeats the rows come back as they are.
    """
    label = places(rows)
    count = int(label.max()) + 1 if len(label) else 0
    if count == len(rows):
        return rows
    first = np.unique(label, return_index=True)[1]
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(count)
    label = rank[label]
    size = np.bincount(label).astype(float)
    kept = rows.take(np.sort(first))
    common = np.zeros((len(rows), len(OBSERVABLE)))
    if rows.has_groups:
        common[:, OBSERVABLE.z] = rows.u_z_group_mm
    own = _means(rows.std**2 - common**2, label, size) / size[:, None]
    std = np.sqrt(own + _means(common**2, label, size))
    std[:, OBSERVABLE.alpha2] = kept.std[:, OBSERVABLE.alpha2]
    retaken = _spread(rows.z_mm, label, count) > 0
    std[~retaken, OBSERVABLE.z] = kept.std[~retaken, OBSERVABLE.z]
    single = size == 1
    std[single] = kept.std[single]
    mean = [
        np.where(single, alone, _means(every[:, None], label, size)[:, 0])
        for alone, every in (
            (kept.x1c, rows.x1c),
            (kept.y1c, rows.y1c),
            (kept.gaze_residual_rad, rows.gaze_residual_rad),
            (kept.z_mm, rows.z_mm),
        )
    ]
    return replace(
        kept, x1c=mean[0], y1c=mean[1], gaze_residual_rad=mean[2], z_mm=mean[3], std=std,
    )  # fmt: skip


def places(rows: Observations) -> IntArray:
    """Return the place and count of each row as a number from 0, shape (n,).

    Rows share one if they read the same and near neighbours join them in x1c, y1c, gaze residual
    and depth.
    """
    label = np.zeros(len(rows), dtype=np.int64)
    width = SAME_PLACE * rows.std
    # Within one count a target may move unseen by the encoder: its rounding error hardly changes.
    for column in (OBSERVABLE.x1c, OBSERVABLE.y1c):
        width[:, column] += rows.std[:, OBSERVABLE.alpha2]
    quantities = (
        (rows.x1c, width[:, OBSERVABLE.x1c]),
        (rows.y1c, width[:, OBSERVABLE.y1c]),
        (rows.gaze_residual_rad, width[:, OBSERVABLE.residual]),
        (rows.z_mm, width[:, OBSERVABLE.z] + SAME_DEPTH * rows.z_mm),
    )
    label = _split(label, rows.alpha2_rad, np.full(len(rows), SAME_COUNT_RAD))
    for _ in range(ROUNDS):
        for values, within in quantities:
            label = _split(label, values, within)
    return label


def _split(label: IntArray, values: FloatArray, within: FloatArray) -> IntArray:
    """Return labels, shape (n,), where gaps of the values wider than `within` divide each.

    What then still extends over more than `WIDEST` widths is divided by widths.
    """
    order = np.lexsort((values, label))
    gap = np.diff(values[order]) > within[order][1:]
    new = gap | (np.diff(label[order]) > 0)
    divided = np.empty_like(label)
    divided[order] = np.concatenate([[0], np.cumsum(new)])[: len(label)]
    if not len(divided):
        return divided
    count = int(divided.max()) + 1
    least, width = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(least, divided, values)
    np.maximum.at(width, divided, within)
    far = _spread(values, divided, count) > WIDEST * width
    cell = np.zeros(len(values), dtype=np.int64)
    moved = far[divided]
    cell[moved] = ((values - least[divided])[moved] / width[divided][moved]).astype(np.int64)
    parts: IntArray = np.unique(np.stack([divided, cell]), axis=1, return_inverse=True)[1].ravel()
    return parts


def _means(values: FloatArray, label: IntArray, size: FloatArray) -> FloatArray:
    """Return the mean over each label, shape (m, k), of values, shape (n, k)."""
    total = np.zeros((len(size), values.shape[1]))
    np.add.at(total, label, values)
    mean: FloatArray = total / size[:, None]
    return mean


def _spread(values: FloatArray, label: IntArray, count: int) -> FloatArray:
    """Return greatest less least value of each label, shape (m,)."""
    least, greatest = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(least, label, values)
    np.maximum.at(greatest, label, values)
    spread: FloatArray = greatest - least
    return spread
