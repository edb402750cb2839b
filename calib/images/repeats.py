"""Pictures that nearly repeat another one: frames of one pose of the board.

Errors that a pose brings (a bent board, the detector's bias with the light and the slant) are the
same in all of them, so that they count as one cluster where covariances are judged by how far views
contradict each other.
"""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.images.bundle import finite

REPEAT_SPACINGS = 0.25
"""Root mean square shift of the corners, in spacings of neighbours, up to which a picture repeats
another one: the refinement windows then hold the same parts of the squares."""

NAMED = 12
"""Pictures named at most."""


def repeat_clusters(pixels: FloatArray, points: FloatArray) -> IntArray:
    """Return the cluster of each view, shape (views,), numbered from 0 in order of appearance.

    Parameters
    ----------
    pixels
        Corners of one camera, px, shape (views, corners, 2); NaN where not found.
    points
        Corners in the board's frame, mm, shape (corners, 3), row by row.
    """
    seen = finite(pixels)
    limit = REPEAT_SPACINGS * _spacings(pixels, points)
    known = np.where(seen[..., None], pixels, 0.0)
    count = np.maximum(seen.sum(axis=-1), 1)[:, None]
    middle = known.sum(axis=1) / count
    leader = np.arange(len(pixels))
    for i in range(len(pixels)):
        near = np.linalg.norm(middle[:i] - middle[i], axis=-1) < 4 * limit[i]
        for j in np.flatnonzero(near & seen[:i].any(axis=-1)):
            both = seen[i] & seen[j]
            if 2 * both.sum() < seen[i].sum():
                continue
            shift = np.sqrt(np.mean(np.sum((pixels[i, both] - pixels[j, both]) ** 2, axis=-1)))
            if shift < limit[i]:
                leader[leader == leader[i]] = leader[j]
                break
    clusters: IntArray = np.unique(leader, return_inverse=True)[1].astype(np.int64)
    return clusters


def repeats_warning(camera: str, images: tuple[str, ...], clusters: IntArray) -> tuple[str, ...]:
    """Return a warning that names the pictures which repeat another one; none without."""
    first = np.unique(clusters, return_index=True)[1]
    again = np.setdiff1d(np.arange(len(images)), first)
    if not len(again):
        return ()
    named = ", ".join(images[i] for i in again[:NAMED]) + (", ..." if len(again) > NAMED else "")
    return (
        f"{camera}: {len(again)} of {len(images)} pictures nearly repeat another one and count "
        f"with it as one pose in the uncertainty, {len(first)} poses in all: {named}",
    )


def summed(values: FloatArray, clusters: IntArray) -> FloatArray:
    """Return sums of the rows of a cluster, shape (clusters, ...)."""
    total: FloatArray = np.zeros((int(clusters.max()) + 1, *values.shape[1:]))
    np.add.at(total, clusters, values)
    return total


def _spacings(pixels: FloatArray, points: FloatArray) -> FloatArray:
    """Return the spacing of neighbouring corners in each view, px, shape (views,)."""
    square = float(np.linalg.norm(points[1] - points[0]))
    found = np.zeros(len(pixels))
    for i, view in enumerate(pixels):
        seen = finite(view)
        if seen.sum() > 1:
            here = view[seen] - view[seen].mean(axis=0)
            there = points[seen] - points[seen].mean(axis=0)
            found[i] = square * np.sqrt(np.sum(here**2) / np.sum(there**2))
    return found
