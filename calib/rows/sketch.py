"""A small sketch of the rows of a table, by which two runs see whether they share rows.

The sketch holds the smallest digests of the rows (bottom-k; Cohen and Kaplan, 2007,
doi:10.1145/1281100.1281133). Tables of up to `KEPT` rows are compared exactly, larger ones by the
share of equal digests among the `KEPT` smallest of both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256

import numpy as np

from calib.dataset.tables import GazeTable
from calib.geometry.board import Corners

KEPT = 64
DIGITS = 16
"""Hexadecimal ones of a digest: two of a million rows are equal by chance once in 10 million."""


@dataclass(frozen=True)
class RowSketch:
    """Some of the rows of a table, drawn by their content.

    Parameters
    ----------
    count
        Number of rows.
    smallest
        Their smallest digests, sorted, at most `KEPT`.
    """

    count: int
    smallest: tuple[str, ...]

    def shared_with(self, other: RowSketch) -> int:
        """Return how many rows both tables have; an estimate where one is larger than `KEPT`."""
        union = sorted(set(self.smallest) | set(other.smallest))
        both = set(self.smallest) & set(other.smallest)
        if max(self.count, other.count) <= KEPT:
            return len(both)
        kept = union[:KEPT]
        jaccard = sum(one in both for one in kept) / len(kept)
        return round(jaccard * (self.count + other.count) / (1 + jaccard))


def sketch(table: GazeTable, corners: Mapping[str, Corners]) -> RowSketch:
    """Return the sketch of a table.

    Parameters
    ----------
    table
        Gaze rows. What the fit does with them has no part in it.
    corners
        Found in the images, by "c1" and "c2": rows with images are known by their corners.
    """
    columns = (
        table.x1c, table.y1c, table.u1_px, table.v1_px, table.alpha2_rad, table.u2_px, table.z_mm,
    )  # fmt: skip
    numbers = np.ascontiguousarray(np.stack(columns, axis=1)).astype("<f8")
    seen = {camera: _digests(found) for camera, found in corners.items()}
    digests = set()
    for i, row in enumerate(numbers):
        parts = [row.tobytes()]
        for camera, name in (("c1", table.image_c1[i]), ("c2", table.image_c2[i])):
            parts.append(b"" if name is None else seen.get(camera, {}).get(name, name.encode()))
        parts.append((table.stereo[i] or "").encode())
        digests.add(sha256(b"\0".join(parts)).hexdigest()[:DIGITS])
    return RowSketch(len(table), tuple(sorted(digests)[:KEPT]))


def _digests(found: Corners) -> dict[str, bytes]:
    """Return a digest of the corners by image, to 1e-3 px: detection is exact, reading is not."""
    return {
        name: sha256(np.round(pixels, 3).astype("<f8").tobytes()).digest()
        for name, pixels in zip(found.images, found.pixels, strict=True)
    }
