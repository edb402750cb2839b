"""C2's pictures of a board at rest: where they show it, as C2 is turned.

All corners together tell a small turn of C2 far better than one: to some 0.01 px. No lens is
needed; a smooth curve over the readings takes up what it does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import Board
from calib.images.detection.board import find_chessboard
from calib.images.detection.charuco import CharucoFinder
from calib.rig.clock import NS_PER_S
from calib.rig.devices import RigDevices
from calib.rig.protocols import Frame, Nanoseconds, Refused, Standstill

TIMEOUT_S: Final = 3.0

SEARCH_STEP_RAD: Final = float(np.deg2rad(10.0))
"""Between looks for the board: less than half of any lens' field."""

PROBE_RAD: Final = float(np.deg2rad(1.0))
"""Turn by which the first slope is told."""

CORNERS_MIN: Final = 8
"""Corners in common that two pictures need."""


@dataclass(frozen=True)
class Look:
    """A picture of the board and where C2 stood.

    Parameters
    ----------
    standing
        Of C2.
    frame
        The picture.
    corners
        In board order, px, shape (corners, 2); NaN where not found.
    """

    standing: Standstill
    frame: Frame
    corners: FloatArray

    @property
    def is_seen(self) -> bool:
        """Whether the board is in the picture."""
        return int(np.isfinite(self.corners).all(axis=1).sum()) >= CORNERS_MIN


class Looking:
    """C2 with its axis, before a board at rest.

    `settle_s` is waited for after each standstill before a picture is exposed.
    """

    def __init__(self, rig: RigDevices, board: Board) -> None:
        self._rig = rig
        self._board = board
        self.settle_s = 0.0

    def go(self, reading_rad: float, *, approach: Literal[-1, 0, 1] = 1) -> Standstill:
        """Move the axis."""
        return self._rig.axis.move(reading_rad, approach=approach)

    def look(self, standing: Standstill, moment: Nanoseconds | None = None) -> Look:
        """Return a picture taken at a standstill, after `moment` where one is given."""
        rest = standing.since_ns + round(self.settle_s * NS_PER_S)
        after = rest if moment is None else moment
        frame = self._rig.c2.after(after, timeout_s=TIMEOUT_S)
        if self._board.type == "charuco":
            corners = CharucoFinder(self._board).find(frame.pixels).pixels
        else:
            corners = find_chessboard(frame.pixels, self._board).pixels
        return Look(standing, frame, corners)

    def look_from(self, reading_rad: float, *, approach: Literal[-1, 0, 1] = 1) -> Look:
        """Move and return a picture in which the board is seen.

        Raises
        ------
        Refused
            If it is not.
        """
        look = self.look(self.go(reading_rad, approach=approach))
        return self._seen(look)

    def _seen(self, look: Look) -> Look:
        if not look.is_seen:
            reading_rad = look.standing.reading_rad
            raise Refused(
                f"C2 does not see the board at {np.degrees(reading_rad):.2f} deg; put it farther "
                "off, or where C2 sees it with some space to either side"
            )
        return look

    def _again(self, reading_rad: float) -> Look:
        """Move and return the second picture: it is new, even if a driver keeps one back."""
        standing = self.go(reading_rad)
        first = self.look(standing)
        return self.look(standing, first.frame.exposed_ns + 1_000_000)

    def find(self) -> Look:
        """Return a picture with the board, from wherever C2 sees it.

        Raises
        ------
        Refused
            If it sees it nowhere.
        """
        low, high = self._rig.axis.range_rad
        here = self._rig.axis.standstill().reading_rad
        places = np.arange(low, high, SEARCH_STEP_RAD)
        for reading in [here, *sorted(places.tolist(), key=lambda r: abs(r - here))]:
            look = self._again(reading)
            if look.is_seen:
                return look
        raise Refused(
            f"C2 does not see the board from anywhere between {np.degrees(low):.0f} and "
            f"{np.degrees(high):.0f} deg; put it up before C2, and check [board] in rig.toml"
        )

    def centre(self, look: Look) -> tuple[Look, float]:
        """Turn C2 until the board is in the middle; return the picture and px by rad."""
        other = self._again(look.standing.reading_rad + PROBE_RAD)
        if not other.is_seen:
            other = self._seen(self._again(look.standing.reading_rad - PROBE_RAD))
        slope = (
            columns([look, other])
            @ np.array([-1.0, 1.0])
            / (other.standing.reading_rad - look.standing.reading_rad)
        )
        if abs(slope) < 1.0:
            raise Refused(
                "C2's picture does not change when the axis turns by a degree; is C2 on the axis, "
                "and are its pictures new ones?"
            )
        middle = (self._rig.c2.image_size[0] - 1) / 2
        way = (middle - float(np.nanmean(look.corners[:, 0]))) / slope
        return self._seen(self._again(look.standing.reading_rad + way)), float(slope)


def columns(looks: list[Look]) -> FloatArray:
    """Return the mean column of the corners that all pictures show, px, shape (n,).

    Raises
    ------
    Refused
        If they have too few in common.
    """
    pixels = np.array([look.corners[:, 0] for look in looks])
    common = np.isfinite(pixels).all(axis=0)
    if common.sum() < CORNERS_MIN:
        raise Refused(
            f"only {int(common.sum())} corners of the board are in all of C2's pictures; put it "
            "farther off, light it evenly"
        )
    mean: FloatArray = pixels[:, common].mean(axis=1)
    return mean


def readings(looks: list[Look]) -> FloatArray:
    """Return where C2 stood, rad, shape (n,)."""
    return np.array([look.standing.reading_rad for look in looks])


@dataclass(frozen=True)
class Curve:
    """How the board's column follows the reading.

    Parameters
    ----------
    slope
        Px by rad in the middle.
    errors_rad
        By how much C2 stood elsewhere than its reading and a smooth curve say, rad, shape (n,).
    std_rad
        Their standard deviation, rad, for the degrees of freedom that are left.
    """

    slope: float
    errors_rad: FloatArray
    std_rad: float


def curve(looks: list[Look], *, degree: int) -> Curve:
    """Return the smooth curve through pictures from many readings."""
    x, y = readings(looks), columns(looks)
    middle, half = x.mean(), max(float(np.ptp(x)) / 2, 1e-9)
    fit = np.polynomial.Polynomial.fit(x, y, degree, domain=[middle - half, middle + half])
    slope = float(fit.deriv()(middle))
    errors = (y - fit(x)) / slope
    left = max(len(x) - degree - 1, 1)
    return Curve(slope, errors, float(np.sqrt((errors**2).sum() / left)))
