"""The corner of a plate as a target: where its two edges would meet, however round the corner is.

A plate is a region brighter or darker than what is behind it, with straight edges. Its corners are
named by where they lie on it as seen by the cameras: `left-upper` is the one from which the plate
extends to the right and down.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from scipy.spatial import cKDTree

from calib.core.arrays import BoolArray, FloatArray
from calib.gaze.edges import EdgeLine, crossing, fit_line, ideal, real
from calib.gaze.target import FLOOR_PX, TargetObservation
from calib.geometry.camera import Camera
from calib.images.detection.picture import Grey

CORNERS: Final = ("left-upper", "left-lower", "right-upper", "right-lower")

SMOOTH_PX: Final = 1.0
"""Standard deviation of the smoothing before edges are looked for, px."""

LEAST_EDGE_PX: Final = 60.0
"""Shorter edges do not say where they point: plain lines of 50 px are no better than corners."""

LEAST_ANGLE_DEG: Final = 20.0
"""Edges that are more nearly parallel do not say where they cross."""

LEAST_AREA_SHARE: Final = 0.01
"""Of the picture: a smaller region is no plate."""

DOUBTFUL_SHARE: Final = 0.3
"""Of an edge's length along which there is a second edge: a bevel, a shadow, another plate."""

ROUND_SHARE: Final = 0.5
"""Of the shorter edge: by so much of its length a corner may be rounded."""

STRAIGHT_PX: Final = 1.5
"""Tolerance by which an outline is taken apart into straight pieces, px."""

BEND_DEG: Final = 8.0
"""Pieces that bend by less are one edge."""

SCRAP_PX: Final = 3.0
"""Pieces of an outline that are shorter say nothing about its direction."""

TRIMMED_SHARE: Final = 0.05
"""Of an edge at both its ends, left out when it is fitted."""


@dataclass(frozen=True)
class Candidate:
    """Two neighbouring edges of a region, each from the corner outwards, px without distortion.

    Parameters
    ----------
    first, second
        Start and end, shape (2, 2).
    """

    first: FloatArray
    second: FloatArray

    @property
    def directions(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors away from the corner."""
        return _unit(self.first[1] - self.first[0]), _unit(self.second[1] - self.second[0])

    @property
    def name(self) -> str:
        """Which corner of a plate this would be."""
        level, upright = sorted(self.directions, key=lambda d: abs(d[1]))
        side = "left" if level[0] > 0 else "right"
        return f"{side}-{'upper' if upright[1] > 0 else 'lower'}"

    @property
    def shorter_px(self) -> float:
        """Length of the shorter edge."""
        return min(float(np.hypot(*np.diff(edge, axis=0)[0])) for edge in (self.first, self.second))

    @property
    def angle_deg(self) -> float:
        """Angle between the edges, 0 to 90 degrees."""
        one, other = self.directions
        return float(np.degrees(np.arccos(np.clip(abs(one @ other), 0, 1))))


@dataclass(frozen=True)
class PlateCorner:
    """One corner of a plate.

    Parameters
    ----------
    which
        One of `CORNERS`.
    lens
        Of the camera whose pictures are looked at; None takes them as free of distortion.
    """

    which: str
    lens: Camera | None = None

    @property
    def name(self) -> str:
        """As the user named it."""
        return f"plate:{self.which}"

    def through(self, lens: Camera) -> PlateCorner:
        """Return the target as a camera sees it."""
        return replace(self, lens=lens)

    def find(self, grey: Grey) -> TargetObservation | None:
        """Return where the corner is; None if it is not to be measured."""
        found = self._measure(grey)
        return found if isinstance(found, TargetObservation) else None

    def fault(self, grey: Grey) -> str:
        """Return why the corner is not to be measured in a picture; "" if it is."""
        found = self._measure(grey)
        return found if isinstance(found, str) else ""

    def _measure(self, grey: Grey) -> TargetObservation | str:
        smooth = cv2.GaussianBlur(grey, (0, 0), SMOOTH_PX)
        mine = [c for c in _candidates(smooth, self.lens, LEAST_EDGE_PX) if c.name == self.which]
        good = [c for c in mine if c.angle_deg >= LEAST_ANGLE_DEG]
        if len(good) > 1:
            return f"{len(good)} corners look like {self.name}: cover all plates but one"
        if not good:
            short = _candidates(smooth, self.lens, LEAST_EDGE_PX / 4)
            return _why(mine or [c for c in short if c.name == self.which], self.name)
        lines = [_line(smooth, self.lens, edge) for edge in (good[0].first, good[0].second)]
        if any(line is None for line in lines):
            return f"an edge of {self.name} cannot be seen along its whole length"
        one, other = (line for line in lines if line is not None)
        doubtful = max(one.doubtful, other.doubtful)
        if doubtful > DOUBTFUL_SHARE:
            return (
                f"along {100 * doubtful:.0f} % of an edge of {self.name} there is a second edge: a "
                "bevel, a shadow or another plate; change the light or the background"
            )
        return self._observation(one, other, np.concatenate([good[0].first, good[0].second]))

    def _observation(self, one: EdgeLine, other: EdgeLine, ends: FloatArray) -> TargetObservation:
        place, covariance = crossing(one, other)
        floor = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
        pixel = real(self.lens, place[None])[0]
        # Noise from picture to picture is counted apart; what all pictures share is the floor.
        return TargetObservation(
            pixel,
            max(FLOOR_PX, floor),
            min(one.length_px, other.length_px),
            real(self.lens, ends),
        )


def _why(near: list[Candidate], name: str) -> str:
    if not near:
        return f"{name} is not in the picture, or does not stand out from its background"
    best = max(near, key=lambda c: c.shorter_px)
    if best.shorter_px < LEAST_EDGE_PX:
        return (
            f"the shorter edge at {name} is {best.shorter_px:.0f} px long, {LEAST_EDGE_PX:.0f} are "
            "needed: bring more of the plate into the picture, or come nearer"
        )
    return (
        f"the edges at {name} meet at {best.angle_deg:.0f} degrees, {LEAST_ANGLE_DEG:.0f} are "
        "needed: turn the plate"
    )


def _line(smooth: Grey, lens: Camera | None, edge: FloatArray) -> EdgeLine | None:
    cut = TRIMMED_SHARE * (edge[1] - edge[0])
    return fit_line(smooth, lens, edge[0] + cut, edge[1] - cut)


def _candidates(smooth: Grey, lens: Camera | None, least_px: float) -> Iterator[Candidate]:
    """Yield the convex corners of all regions, bright and dark, between edges of some length."""
    level, _ = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    for bright in (True, False):
        mask = ((smooth > level) == bright).astype(np.uint8)
        outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        for outline in outlines:
            if cv2.contourArea(outline) >= LEAST_AREA_SHARE * smooth.size:
                yield from _corners(
                    _straight_edges(outline[:, 0].astype(np.float64), smooth.shape, lens, least_px)
                )


def _corners(edges: Sequence[_Edge]) -> Iterator[Candidate]:
    """Yield the convex corners between neighbouring edges of one outline."""
    for k, edge in enumerate(edges):
        following = edges[(k + 1) % len(edges)]
        if len(edges) < 2 or edge.closed_by_rim:
            continue
        gap = float(np.hypot(*(following.ends[0] - edge.ends[1])))
        lengths = [float(np.hypot(*np.diff(e.ends, axis=0)[0])) for e in (edge, following)]
        if gap > ROUND_SHARE * min(lengths):
            continue
        one, other = (_unit(np.diff(e.ends, axis=0)[0]) for e in (edge, following))
        # OpenCV goes around a region clockwise as seen, so that it lies to the right (y is down).
        turn = one[0] * other[1] - one[1] * other[0]
        if turn > np.sin(np.radians(BEND_DEG)):
            yield Candidate(first=edge.ends[::-1], second=following.ends)


@dataclass(frozen=True)
class _Edge:
    """A straight piece of an outline; whether the picture's rim lies between it and the next."""

    ends: FloatArray
    closed_by_rim: bool


def _straight_edges(
    outline: FloatArray, shape: tuple[int, ...], lens: Camera | None, least_px: float
) -> list[_Edge]:
    """Return the straight pieces of an outline, in its order, without the picture's rim."""
    outline = _clockwise(outline)
    without = ideal(lens, outline)
    usable = np.isfinite(without).all(axis=1)
    outline, without = outline[usable], without[usable]
    if len(without) < 8:
        return []
    vertices = _vertices(without)
    rim = _on_rim(outline, shape)
    pieces = list(zip(vertices, [*vertices[1:], vertices[0]], strict=True))
    found: list[_Edge] = []
    for start, end in pieces:
        way = np.arange(start, end if end > start else end + len(outline)) % len(outline)
        if len(way) < 2:
            continue
        if rim[way].mean() > 0.5:
            if found:
                found[-1] = replace(found[-1], closed_by_rim=True)
            continue
        ends = without[[way[0], way[-1]]]
        if np.hypot(*np.diff(ends, axis=0)[0]) < SCRAP_PX:
            continue
        if found and not found[-1].closed_by_rim and _bend(found[-1].ends, ends) < BEND_DEG:
            found[-1] = replace(found[-1], ends=np.stack([found[-1].ends[0], ends[1]]))
        else:
            found.append(_Edge(ends, closed_by_rim=False))
    return _long(found, least_px)


def _long(edges: Sequence[_Edge], least_px: float) -> list[_Edge]:
    """Return the edges of some length; what is between them may be the round of a corner."""
    found: list[_Edge] = []
    for edge in edges:
        if np.hypot(*np.diff(edge.ends, axis=0)[0]) >= least_px:
            found.append(edge)
        elif edge.closed_by_rim and found:
            found[-1] = replace(found[-1], closed_by_rim=True)
    return found


def _clockwise(outline: FloatArray) -> FloatArray:
    x, y = outline.T
    area = float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    return outline if area > 0 else outline[::-1]


def _vertices(outline: FloatArray) -> list[int]:
    """Return the places, increasing, where an outline bends."""
    polygon = cv2.approxPolyDP(outline.astype(np.float32)[:, None], STRAIGHT_PX, closed=True)[:, 0]
    _, nearest = cKDTree(outline).query(polygon)
    return [int(i) for i in np.unique(nearest)]


def _on_rim(outline: FloatArray, shape: tuple[int, ...]) -> BoolArray:
    height, width = shape
    x, y = outline.T
    rim: BoolArray = (x <= 1) | (y <= 1) | (x >= width - 2) | (y >= height - 2)
    return rim


def _bend(one: FloatArray, other: FloatArray) -> float:
    """Return the angle between two pieces of an outline, degrees."""
    a, b = (_unit(np.diff(piece, axis=0)[0]) for piece in (one, other))
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


def _unit(vector: FloatArray) -> FloatArray:
    unit: FloatArray = vector / np.hypot(*vector)
    return unit
