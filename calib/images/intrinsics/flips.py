"""Pictures that were turned or mirrored after they were taken, tried against the others' lens.

Such a picture shows a possible board: only the lens is another one, its centre and its tangential
part on the other side. Each picture is fitted as it is and turned, mirrored or upside down, by its
pose alone; those that fit better otherwise are put so, the lens is solved again, until all stay.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.core.errors import EstimationError
from calib.core.gate import Gate
from calib.geometry.board import Board, Corners, LensFit
from calib.images.bundle import finite
from calib.images.intrinsics.lenses import lens_of
from calib.images.intrinsics.solvers import fit_lens
from calib.images.mrcal.solves import MIN_CORNERS
from calib.images.pairs import single_view_pose

GAIN = 25.0
"""Twice the gain in log likelihood, in units of the views' own scatter, by which a picture must fit
better otherwise: 1 in 2 million by chance."""

SUSPECT_GAIN = 6.0
"""That gain in some picture from which on the lens is solved again: while many are turned, the lens
stands between the two and each shows little."""

GOOD_RATIO = 2.0
"""Its rms over that of the median picture up to which a picture fits otherwise; one that fits in no
way is wrong for another reason."""

MINORITY = 0.5
"""Share of pictures up to which they are called the odd ones."""

LEAST_SIGMA_PX = 1e-3
"""Corners that were computed are exact, and rounding is no gain."""

POSE = 6
_ROUNDS = 5
_WAYS = ("as it is", "turned by 180 deg", "mirrored left to right", "mirrored top to bottom")


def flipped_pictures(
    corners: Corners, board: Board, fit: LensFit, *, points: FloatArray, factor: float
) -> dict[str, str]:
    """Return the pictures that fit the others' lens only turned or mirrored, with the way.

    Parameters
    ----------
    fit
        Of all pictures as they are.
    points
        Corners in the board's frame, mm, shape (corners, 3), as the fit took them.
    factor
        Variance that views show over that of independent corner noise.
    """
    used = finite(fit.residuals)
    count = used.sum(axis=-1)
    views = np.flatnonzero(count >= MIN_CORNERS)
    ways = np.zeros(len(used), dtype=np.int64)
    lens = lens_of(fit.camera)
    current = fit
    every = range(len(_WAYS))
    put = [_put(corners, board, used, np.full(len(used), way)) for way in every]
    gains, errors = np.zeros((2, len(used), len(_WAYS)))
    for _ in range(_ROUNDS):
        gains, errors = _gains(current, put, points, views, factor)
        best = gains.argmax(axis=-1)
        # While nothing is known each picture need only lean to one side.
        chosen = np.where(gains.max(axis=-1) > SUSPECT_GAIN, best, 0)
        if np.array_equal(chosen, ways):
            break
        ways = chosen
        try:
            now = _put(corners, board, used, ways)
            current = fit_lens(now, board, lens=lens, points=points, start=fit.camera)
        except EstimationError:
            return {}
    fitted = errors[np.arange(len(ways)), ways]
    good = fitted < GOOD_RATIO * np.median(fitted[views])
    sure = (ways > 0) & (gains.max(axis=-1) > GAIN) & good
    if sure.sum() > MINORITY * len(views):
        return {}
    return {corners.images[i]: _WAYS[ways[i]] for i in np.flatnonzero(sure)}


def _gains(
    fit: LensFit, put: list[Corners], points: FloatArray, views: IntArray, factor: float
) -> tuple[FloatArray, FloatArray]:
    """Return how much better each view fits in each way than as it is, and its rms, px.

    Both of shape (views, ways); `put` holds the views in each way.
    """
    squares, errors = np.zeros((2, len(put[0].pixels), len(put)))
    for way, corners in enumerate(put):
        for i in views:
            view = corners.pixels[i]
            errors[i, way] = single_view_pose(fit.camera, points=points, pixels=view)[1]
            squares[i, way] = errors[i, way] ** 2 * 2 * int(finite(view).sum())
    coordinates = 2 * int(finite(put[0].pixels[views]).sum())
    redundancy = max(coordinates - POSE * len(views), 1)
    variance = max(float(squares[views].min(axis=-1).sum()) / redundancy, LEAST_SIGMA_PX**2)
    return (squares[:, :1] - squares) / (variance * max(factor, 1.0)), errors


def _put(corners: Corners, board: Board, used: BoolArray, ways: IntArray) -> Corners:
    """Return the corners used with each view put into a way; order stays that of a real board."""
    pixels = np.where(used[..., None], corners.pixels, np.nan)
    width, height = corners.image_size
    for i in np.flatnonzero(ways):
        u, v = pixels[i].T
        if ways[i] in (1, 2):
            u = width - 1 - u
        if ways[i] in (1, 3):
            v = height - 1 - v
        view = np.stack([u, v], axis=-1)
        if ways[i] in (2, 3):
            grid = view.reshape(board.rows, board.columns, 2)
            view = grid[:, ::-1].reshape(-1, 2)
        pixels[i] = view
    return replace(corners, pixels=pixels)


def way_gate(camera: str, flipped: dict[str, str], views: int) -> Gate:
    """Gate on pictures that were turned or mirrored."""
    if not flipped:
        return Gate(f"{camera}-way-up", True, f"all {views} pictures fit one lens as they are")
    named = "; ".join(
        f"{way}: {', '.join(image for image, other in flipped.items() if other == way)}"
        for way in dict.fromkeys(flipped.values())
    )
    return Gate(
        f"{camera}-way-up",
        False,
        f"{len(flipped)} of {views} pictures fit the lens of the others only when put otherwise "
        f"({named}); take them again from the camera, unturned (viewers turn pixels by the EXIF "
        f"tag, drivers mirror them), or name them in exclude = [...] of [cameras.{camera}]",
    )
