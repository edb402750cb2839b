"""The corners of a board as a grid: its spacing, its regularity, its colours, its direction.

A detector may return a regular-looking grid that is none, a board of another size, or the right
board counted from its other end. The grid itself and the grey values of its squares tell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.geometry.board import Board
from calib.images.detection.picture import Grey

IRREGULAR_SPACINGS = 0.25
"""A corner further than this from a smooth grid is wrong, in spacings to its neighbours. A cubic
follows boards tilted by 35 deg behind strong barrel distortion (k1 = -0.35) within 0.1; a grid that
skips a row is off by 0.5."""

ALTERNATING_SHARE = 0.9
"""Share of inner squares that must differ from their neighbours the way a chessboard does; a
texture reaches 0.5."""

SIDE_CONTRAST = 0.5
"""A row of squares belongs to the board if it alternates at least this strongly, relative to the
outermost inner row on that side: squares give 1, a white rim 0."""

EDGE_SQUARES = 0.4
"""How far beyond the outermost corners squares are looked for, in squares: boards are often cut
through their outer squares."""

CONTRAST_MIN = 4.0
"""Least difference of white and black squares, grey values of 8 bits: the noise of an imager."""

_CAUCHY_SPACINGS = 0.1
_ROUNDS = 10
_DEGREES = (3, 2, 1)
_CORNERS_PER_TERM = 1.5
_SIDE_SQUARES_MIN = 2


def seen(pixels: FloatArray) -> BoolArray:
    """Return which corners, shape (..., 2), are not NaN, shape (...)."""
    found: BoolArray = np.asarray(np.isfinite(pixels).all(axis=-1))
    return found


def spacing(pixels: FloatArray, board: Board) -> FloatArray:
    """Return distances to the nearest neighbour along rows and columns, px, shape (corners,).

    Where a corner has no neighbour the median of the others stands in; NaN where it is missing.
    """
    grid = _grid(pixels, board)
    nearest = np.full(grid.shape[:2], np.nan)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=-1)
    down = np.linalg.norm(np.diff(grid, axis=0), axis=-1)
    for part, steps in (
        (nearest[:, :-1], across),
        (nearest[:, 1:], across),
        (nearest[:-1], down),
        (nearest[1:], down),
    ):
        np.fmin(part, steps, out=part)
    flat = nearest.ravel()
    known = np.isfinite(flat)
    flat[~known] = np.median(flat[known]) if known.any() else np.nan
    flat[~seen(pixels)] = np.nan
    return flat


def smooth_grid(pixels: FloatArray, board: Board) -> FloatArray:
    """Return where a smooth grid through the corners has them, px, shape (corners, 2).

    A cubic of column and row (lower where corners are few), fitted with Cauchy weights, so that
    single wrong corners do not bend it. Missing corners are filled in.
    """
    found = seen(pixels)
    design = _design(found, board)
    gap = float(np.median(spacing(pixels, board)[found]))
    weight = np.ones(int(found.sum()))
    smooth = np.empty_like(pixels)
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)[:, None]
        coefficients = np.linalg.lstsq(root * design[found], root * pixels[found], rcond=None)[0]
        smooth = design @ coefficients
        misfit = np.linalg.norm(smooth[found] - pixels[found], axis=-1) / gap
        if misfit.max() < _CAUCHY_SPACINGS:
            break
        weight = 1 / (1 + (misfit / _CAUCHY_SPACINGS) ** 2)
    return smooth


def irregular(pixels: FloatArray, board: Board) -> BoolArray:
    """Return which corners stand off the smooth grid, shape (corners,); missing ones do not."""
    misfit = np.linalg.norm(smooth_grid(pixels, board) - pixels, axis=-1)
    off: BoolArray = misfit > IRREGULAR_SPACINGS * spacing(pixels, board)
    return off


def _design(found: BoolArray, board: Board) -> FloatArray:
    """Return monomials of column and row, as high as the number of corners found can carry."""
    x, y = np.meshgrid(np.linspace(-1, 1, board.columns), np.linspace(-1, 1, board.rows))
    grid = found.reshape(board.rows, board.columns)
    columns, rows = int(grid.any(axis=0).sum()), int(grid.any(axis=1).sum())
    terms: list[FloatArray] = []
    for degree in _DEGREES:
        terms = [
            (x**i * y**j).ravel()
            for i in range(min(degree, columns - 1) + 1)
            for j in range(min(degree - i, rows - 1) + 1)
        ]
        if found.sum() >= _CORNERS_PER_TERM * len(terms):
            break
    return np.stack(terms, axis=-1)


@dataclass(frozen=True)
class Squares:
    """How the squares in and around a grid of corners alternate.

    Parameters
    ----------
    contrast
        Half the difference of the squares of the two colours, grey values; negative where the
        square inside the first corner is dark.
    alternating
        Share of inner squares that differ from their neighbours as the colours ask.
    edge
        Contrast of the row of squares just outside the outermost corners, relative to the row just
        inside them: left, right, top, bottom; NaN where out of the picture.
    beyond
        The same of the next row out.
    """

    contrast: float
    alternating: float
    edge: tuple[float, float, float, float]
    beyond: tuple[float, float, float, float]

    @property
    def is_board(self) -> bool:
        """Whether the grid is a chessboard whose every corner lies between four squares."""
        return (
            2 * abs(self.contrast) >= CONTRAST_MIN
            and self.alternating >= ALTERNATING_SHARE
            and not any(side < SIDE_CONTRAST for side in self.edge)
        )

    @property
    def goes_on(self) -> bool:
        """Whether the chessboard goes on beyond the squares that the declared corners bound."""
        return any(side >= SIDE_CONTRAST for side in self.beyond)


def squares(grey: Grey, pixels: FloatArray, board: Board) -> Squares:
    """Return how the squares alternate around complete corners, shape (corners, 2), px."""
    grid = _grid(pixels, board)
    values = _square_values(grey, _extended(grid, (EDGE_SQUARES,)))
    parity = _parity(values)
    inner = (slice(1, -1), slice(1, -1))
    contrast = _contrast(values[inner], parity[inner])
    around = np.stack([values[:-2, 1:-1], values[2:, 1:-1], values[1:-1, :-2], values[1:-1, 2:]])
    # Off the picture there is no neighbour; an inner square always has two.
    step = (values[inner] - np.nanmean(around, axis=0)) * parity[inner] * np.sign(contrast)
    return Squares(
        contrast=contrast,
        alternating=float((step > 0).mean()),
        edge=_sides(values, rings=1),
        beyond=_sides(_square_values(grey, _extended(grid, (1.0, 2.0))), rings=2),
    )


def _parity(values: FloatArray) -> FloatArray:
    """Return 1 for squares of one colour and -1 for those of the other, in the shape of `values`.

    With one or two rings around them, the first inner square gets 1.
    """
    rows, columns = np.indices(values.shape)
    return np.where((rows + columns) % 2 == 0, 1.0, -1.0)


def _sides(values: FloatArray, *, rings: int) -> tuple[float, float, float, float]:
    """Return the contrast of the sides of the outermost of some rings around the inner squares.

    Relative to the outermost inner squares of the same side.
    """
    parity = _parity(values)
    along = slice(rings, -rings)

    def ratio(axis: int, end: int) -> float:
        rows, signs = (np.moveaxis(a, axis, 0)[::end, along] for a in (values, parity))
        outer, within = _contrast(rows[0], signs[0]), _contrast(rows[rings], signs[rings])
        return outer / within if within else float("nan")

    return ratio(1, 1), ratio(1, -1), ratio(0, 1), ratio(0, -1)


def _contrast(values: FloatArray, parity: FloatArray) -> float:
    """Return half the difference of mean even and mean odd squares; NaN if hardly any are seen."""
    even, odd = values[parity > 0], values[parity < 0]
    even, odd = even[np.isfinite(even)], odd[np.isfinite(odd)]
    if not even.size or not odd.size or even.size + odd.size < _SIDE_SQUARES_MIN:
        return float("nan")
    return float(even.mean() - odd.mean()) / 2


def _grid(pixels: FloatArray, board: Board) -> FloatArray:
    """Return corners as (rows, columns, 2)."""
    return pixels.reshape(board.rows, board.columns, 2)


def _extended(grid: FloatArray, steps: tuple[float, ...]) -> FloatArray:
    """Add rows and columns on each side of a grid, `steps` squares out, nearest first."""
    for axis in (0, 1):
        lines = np.moveaxis(grid, axis, 0)
        ahead = [_beyond(lines[:3], step) for step in steps]
        behind = [_beyond(lines[-3:][::-1], step) for step in steps]
        grid = np.moveaxis(np.stack([*ahead[::-1], *lines, *behind]), 0, axis)
    return grid


def _beyond(lines: FloatArray, step: float) -> FloatArray:
    """Return the line `step` squares before the first of three, shape (3, ...), by a quadratic."""
    weights = np.array([(step + 1) * (step + 2), -2 * step * (step + 2), step * (step + 1)]) / 2
    return np.asarray(np.tensordot(weights, lines, axes=1))


def _square_values(grey: Grey, grid: FloatArray) -> FloatArray:
    """Return the mean grey value around the middle of each square, NaN out of the picture."""
    corners = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]])
    # Nine points over the middle half of the square.
    t = np.array([0.3, 0.5, 0.7])
    weights = np.stack(
        [np.outer(1 - t, 1 - t), np.outer(1 - t, t), np.outer(t, 1 - t), np.outer(t, t)]
    ).reshape(4, -1)
    points = np.einsum("krcd,kp->rcpd", corners, weights)
    at = np.nan_to_num(points, nan=-1e6).round().astype(np.int64)
    u, v = at[..., 0], at[..., 1]
    height, width = grey.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    values = grey[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)].astype(np.float64)
    mean: FloatArray = np.where(inside.all(axis=-1), values.mean(axis=-1), np.nan)
    return mean


def canonical(pixels: FloatArray, verdict: Squares, board: Board) -> FloatArray:
    """Return corners, shape (corners, 2), in the one order that views can agree upon.

    Rows run clockwise from columns, as on a board seen from its front, whatever the detector did.
    Of the ways to count a board that looks the same after a turn, those begin at a dark inner
    square, if any does; among the rest the one whose columns run most to the right is taken, which
    is the same board point in all views only while the board is not turned upside down: see
    `orient_like`.

    Parameters
    ----------
    verdict
        What `squares` says of `pixels`.
    """
    grid, dark = _grid(pixels, board), verdict.contrast < 0
    if _turning(grid) < 0:
        # The first square is now the last of its row.
        grid, dark = grid[:, ::-1], dark ^ (board.columns % 2 == 1)
    ways = [(way, dark ^ swaps) for way, swaps in _turns(grid, board)]
    if any(starts_dark for _, starts_dark in ways):
        ways = [way for way in ways if way[1]]
    return max((way for way, _ in ways), key=lambda way: float(_direction(way)[0])).reshape(-1, 2)


def orient_like(reference: FloatArray, other: FloatArray, board: Board) -> FloatArray:
    """Return corners of one camera counted from the same end as another camera's of the same pair.

    A board with an even x even or odd x odd count looks the same after half a turn (a square one
    after a quarter); each view is turned so that its columns run as in the reference view. That
    holds for cameras rolled against each other by less than 90 deg (square boards: 45).

    Parameters
    ----------
    reference, other
        Shapes (views, corners, 2), px; views where either is incomplete stay as they are.
    """
    if board.type != "chessboard":
        return other
    turned = other.copy()
    for i, (like, view) in enumerate(zip(reference, other, strict=True)):
        if not (np.isfinite(like).all() and np.isfinite(view).all()):
            continue
        towards = _direction(_grid(like, board))
        ways = [way for way, swapped in _turns(_grid(view, board), board) if not swapped]
        best = max(ways, key=lambda way: float(_direction(way) @ towards))
        turned[i] = best.reshape(-1, 2)
    return turned


def _turns(grid: FloatArray, board: Board) -> Iterator[tuple[FloatArray, bool]]:
    """Yield the grid after each turn that maps its shape onto itself, and if colours are swapped.

    Half a turn swaps them if one count is even and the other odd, a quarter if both are odd.
    """
    if board.columns == board.rows:
        for quarters in range(4):
            yield np.rot90(grid, quarters), quarters % 2 == 1 and board.columns % 2 == 1
    else:
        yield grid, False
        yield np.rot90(grid, 2), (board.columns + board.rows) % 2 == 1


def _direction(grid: FloatArray) -> FloatArray:
    """Return the unit vector along which columns run in the picture."""
    along = np.nansum(grid[:, 1:] - grid[:, :-1], axis=(0, 1))
    return np.asarray(along / np.linalg.norm(along))


def _turning(grid: FloatArray) -> float:
    """Return a number that is positive if rows run clockwise from columns, y down."""
    across = np.nansum(grid[:, 1:] - grid[:, :-1], axis=(0, 1))
    down = np.nansum(grid[1:] - grid[:-1], axis=(0, 1))
    return float(across[0] * down[1] - across[1] * down[0])
