"""How the rows came about: their order, times, sides of approach and groups."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.dataset.contents import Dataset
from calib.rows.observations import Observations


@dataclass(frozen=True)
class RowHistory:
    """What a table says of how each of its rows was taken, by id.

    Parameters
    ----------
    time_s
        When, s from any origin; empty where the table does not say it.
    approach
        -1 or 1, the side from which the axis came to rest; empty where not said.
    step_rad
        One count of the encoder.
    full_step_rad
        One full step of the motor; None if not stated.
    """

    time_s: Mapping[str, float]
    approach: Mapping[str, float]
    step_rad: float
    full_step_rad: float | None = None


def row_history(dataset: Dataset) -> RowHistory:
    """Return the history of the gaze rows of a dataset that has some."""
    table, encoder = dataset.gaze, dataset.manifest.encoder
    if table is None or encoder is None:
        raise ValueError("a dataset without gaze rows has no history of them")
    full = encoder.full_step_deg
    return RowHistory(
        time_s=_named(table.ids, table.time_s),
        approach=_named(table.ids, table.approach),
        step_rad=float(np.deg2rad(encoder.resolution_deg)),
        full_step_rad=None if full is None else float(np.deg2rad(full)),
    )


def _named(ids: tuple[str, ...], values: FloatArray) -> Mapping[str, float]:
    return dict(zip(ids, values.tolist(), strict=True)) if len(values) else {}


@dataclass(frozen=True)
class HistoryArrays:
    """The rows' history, as arrays over the rows.

    Parameters
    ----------
    ids, groups
        Of the rows.
    rank
        Place of each row in the order in which they were taken, shape (n,).
    progress
        From 0 at the first row to 1 at the last, by time where it is known, shape (n,).
    approach
        -1 or 1, shape (n,); shape (0,) where not known.
    step_rad, full_step_rad
        As `RowHistory`.
    """

    ids: tuple[str, ...]
    groups: tuple[str, ...]
    rank: IntArray
    progress: FloatArray
    approach: FloatArray
    step_rad: float
    full_step_rad: float | None

    @classmethod
    def of(cls, rows: Observations, history: RowHistory, *, is_left: bool) -> HistoryArrays:
        """Return the session of rows, which stand in their table's order.

        Parameters
        ----------
        is_left
            Whether C2 stands at -X of C1: the rows are then mirrored, and so are approaches.
        """
        count = len(rows)
        moment = np.arange(count, dtype=float)
        if history.time_s:
            moment = np.array([history.time_s[name] for name in rows.ids])
        span = float(np.ptp(moment)) or 1.0
        order = np.argsort(moment, kind="stable")
        rank = np.empty(count, dtype=np.int64)
        rank[order] = np.arange(count)
        approach = np.zeros(0)
        if history.approach:
            approach = np.array([history.approach[name] for name in rows.ids])
        return cls(
            ids=rows.ids,
            groups=rows.groups,
            rank=rank,
            progress=(moment - moment.min()) / span,
            approach=-approach if is_left else approach,
            step_rad=history.step_rad,
            full_step_rad=history.full_step_rad,
        )

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, rows: BoolArray | IntArray) -> HistoryArrays:
        """Return the session of the chosen rows; ranks close up."""
        index = np.arange(len(self))[rows]
        order = np.argsort(self.rank[index], kind="stable")
        rank = np.empty(len(index), dtype=np.int64)
        rank[order] = np.arange(len(index))
        return HistoryArrays(
            ids=tuple(self.ids[i] for i in index),
            groups=tuple(self.groups[i] for i in index),
            rank=rank,
            progress=self.progress[index],
            approach=self.approach[index] if len(self.approach) else self.approach,
            step_rad=self.step_rad,
            full_step_rad=self.full_step_rad,
        )

    @property
    def in_order(self) -> IntArray:
        """Rows in the order in which they were taken, shape (n,)."""
        return np.argsort(self.rank, kind="stable")
