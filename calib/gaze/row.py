"""One gaze row: a standstill, and pictures of both cameras that belong to it.

A row cannot be made of the reading of one stop and a picture of another: it takes one `Standstill`
and refuses frames that were not exposed after it began.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.gaze.target import TargetObservation
from calib.rig.protocols import Frame, Refused, Standstill

FIRST_NOISE_PX, FIRST_FREEDOM = 0.05, 2.0
"""Scatter of a coordinate from picture to picture before there are repeats, and how many degrees of
freedom that guess is worth: six pictures of one camera outweigh it."""

MOVED_SIGMAS = 3.0
"""A target seen elsewhere by more than so many standard deviations has moved."""

STILL_PX = 0.02
"""Least standard deviation of a difference of two observations at rest, px: some three times that
may be air and floor, and is nothing that a row could not bear."""


@dataclass(frozen=True)
class SeenTarget:
    """A picture and the target in it; `age_ms` old when it came to hand."""

    frame: Frame
    observation: TargetObservation
    age_ms: float = 0.0


@dataclass(frozen=True)
class TargetScatter:
    """How a target's coordinates scatter from picture to picture at rest, over all gazes so far.

    Parameters
    ----------
    sum_squares
        Of deviations from each gaze's mean, both coordinates, px squared.
    freedom
        Its degrees of freedom.
    """

    sum_squares: float = FIRST_FREEDOM * FIRST_NOISE_PX**2
    freedom: float = FIRST_FREEDOM

    @property
    def std_px(self) -> float:
        """Standard deviation of a coordinate of one picture, px."""
        return float(np.sqrt(self.sum_squares / self.freedom))

    def after(self, seen: Sequence[SeenTarget]) -> TargetScatter:
        """Return it with the repeats of one more gaze."""
        pixels = _pixels(seen)
        away = pixels - pixels.mean(axis=0)
        return TargetScatter(
            self.sum_squares + float((away**2).sum()), self.freedom + away[1:].size
        )


@dataclass(frozen=True)
class GazeRow:
    """What was read of one target at one standstill.

    Parameters
    ----------
    standstill
        Of C2.
    pixel_c1, pixel_c2
        The target, mean of the pictures, px, shape (2,).
    u_c1_px, u_c2_px
        Standard uncertainty of a coordinate, px.
    c1, c2
        The pictures; the first of each is the one to keep.
    moves, looks
        How often C2 came to rest, and from how many places it looked in vain.
    """

    standstill: Standstill
    pixel_c1: FloatArray
    pixel_c2: FloatArray
    u_c1_px: float
    u_c2_px: float
    c1: tuple[SeenTarget, ...]
    c2: tuple[SeenTarget, ...]
    moves: int
    looks: int


def make_row(
    standstill: Standstill,
    *,
    c1: Sequence[SeenTarget],
    c2: Sequence[SeenTarget],
    noise_c1: TargetScatter,
    noise_c2: TargetScatter,
    moves: int,
    looks: int,
) -> GazeRow:
    """Return the row of a standstill.

    Raises
    ------
    Refused
        If a picture of C2 was not exposed while it stood still, or the pictures of a camera show
        the target at different places.
    """
    for seen in c2:
        if seen.frame.exposed_ns < standstill.since_ns:
            early = (standstill.since_ns - seen.frame.exposed_ns) / 1e6
            raise Refused(f"a picture of C2 was exposed {early:.1f} ms before it stood still")
    return GazeRow(
        standstill=standstill,
        pixel_c1=_pixels(c1).mean(axis=0),
        pixel_c2=_pixels(c2).mean(axis=0),
        u_c1_px=_uncertainty(c1, noise_c1),
        u_c2_px=_uncertainty(c2, noise_c2),
        c1=tuple(c1),
        c2=tuple(c2),
        moves=moves,
        looks=looks,
    )


def refuse_moved(
    name: str, before: Sequence[SeenTarget], after: Sequence[SeenTarget], noise: TargetScatter
) -> None:
    """Refuse a target that a camera sees elsewhere than before.

    Raises
    ------
    Refused
        With the distance.
    """
    way = _pixels(after).mean(axis=0) - _pixels(before).mean(axis=0)
    std = noise.std_px * np.sqrt(1 / len(before) + 1 / len(after))
    limit = MOVED_SIGMAS * max(float(std), STILL_PX)
    if np.abs(way).max() > limit:
        raise Refused(
            f"the target moved while it was gazed at: {name} sees it {np.hypot(*way):.2f} px from "
            f"where it was (limit {limit:.2f} px); hold it still, or use --follow"
        )


def refuse_unsteady(name: str, seen: Sequence[SeenTarget], noise: TargetScatter) -> None:
    """Refuse pictures that do not show the target at one place.

    Raises
    ------
    Refused
        With the distance.
    """
    pixels = _pixels(seen)
    spread = float(np.abs(pixels - np.median(pixels, axis=0)).max())
    limit = UNSTEADY_SIGMAS * max(noise.std_px, STILL_PX)
    if spread > limit:
        raise Refused(
            f"{name} sees the target at different places in pictures at rest, {spread:.2f} px "
            f"apart (limit {limit:.2f} px): it moved, or C2 still trembles"
        )


UNSTEADY_SIGMAS = 5.0
"""One picture of many is off by 3 sigma every day; by 5 it shows something else."""


def _pixels(seen: Sequence[SeenTarget]) -> FloatArray:
    return np.array([s.observation.pixel for s in seen])


def _uncertainty(seen: Sequence[SeenTarget], noise: TargetScatter) -> float:
    """Return the standard uncertainty of a mean coordinate: what averages out and what does not."""
    floor = max(s.observation.floor_px for s in seen)
    return float(np.hypot(floor, noise.std_px / np.sqrt(len(seen))))
