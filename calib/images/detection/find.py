"""Stage: the board's corners in the images of one camera."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from calib.core.arrays import FloatArray
from calib.core.errors import InputError, Problem
from calib.geometry.board import Board, Corners
from calib.images.detection.board import CHESSBOARD_DETECTORS, Found, find_chessboard, other_count
from calib.images.detection.charuco import INVERTED, CharucoFinder
from calib.images.detection.marks import marker_dictionary, window_pattern
from calib.images.detection.picture import Grey, read_grey
from calib.images.opencv import steady_opencv

Progress = Callable[[int, int], None]
"""Called with the number of images done and of all."""

DETECTORS = tuple(CHESSBOARD_DETECTORS)
"""What `detect` can be told to use on chessboards; ChArUco boards know only their own."""

THREADS = 2
"""OpenCV's functions let go of Python's lock: two threads are 1.8 to 1.9 times as fast as one, and
more memory than two pictures' is not needed."""

LARGER_MIN = 3
"""Pictures that must show the board go on beyond its declared size; clutter beside the board does
it in one of 25."""

NAMED = 5
"""Pictures that are named at most."""

COUNT_TRIED_ON = 3
"""Pictures in which boards of other counts are sought when the declared one is in none."""


@dataclass(frozen=True)
class _Outcome:
    """What became of one image: a board (or none) or a problem."""

    found: Found | None = None
    problem: Problem | None = None


def detect(
    root: Path,
    images: Sequence[str],
    board: Board,
    *,
    image_size: tuple[int, int],
    detector: str = "cascade",
    cache: Mapping[str, FloatArray] | None = None,
    sha256: Mapping[str, str] | None = None,
    threads: int = THREADS,
    progress: Progress | None = None,
) -> Corners:
    """Find the board in the images of one camera.

    Each image is read once, however often it is named; one named in the cache is not read at all. A
    board not found is a view of NaN with detector "none".

    Parameters
    ----------
    root
        Folder the names are relative to.
    images
        One a view.
    image_size
        Width and height, px, all images must have.
    detector
        One of `DETECTORS`.
    cache
        Corners known beforehand by image, px, shape (corners, 2), as `read_cache` gives them.
    sha256
        Digests, in hex, that the bytes of images must have.

    Raises
    ------
    InputError
        With every image that cannot be read or has another size; if the board is found to have
        more squares than declared, or is in no picture while one with another count is.
    """
    known = dict(cache or {})
    unique = list(dict.fromkeys(images))
    search = _Search(root, board, image_size, detector, known, dict(sha256 or {}))
    outcomes: dict[str, _Outcome] = {}
    with steady_opencv(), ThreadPoolExecutor(max(1, threads)) as pool:
        for name, outcome in zip(unique, pool.map(search.run, unique), strict=True):
            outcomes[name] = outcome
            if progress is not None:
                progress(len(outcomes), len(unique))
        problems = [o.problem for o in outcomes.values() if o.problem is not None]
        found = {name: o.found for name, o in outcomes.items() if o.found is not None}
        read = {name: view for name, view in found.items() if name not in known}
        problems = problems or _wrong_count(root, read, board)
        if not problems:
            found, remarks = _undisturbed(root, found, board)
            remarks = (*remarks, *_inverted(found))
    if problems:
        raise InputError(problems)
    views = [found[name] for name in images]
    empty = np.empty((0, board.corner_count, 2))
    return Corners(
        images=tuple(images),
        pixels=np.stack([view.pixels for view in views]) if views else empty,
        detector=tuple(view.detector for view in views),
        image_size=image_size,
        remarks=remarks,
    )


def _undisturbed(
    root: Path, found: dict[str, Found], board: Board
) -> tuple[dict[str, Found], tuple[str, ...]]:
    """Return boards by the small window where marks in squares disturb the large one, and words."""
    both = {name: view for name, view in found.items() if view.small is not None}
    small = [view.small for view in both.values() if view.small is not None]
    pattern = window_pattern([view.pixels for view in both.values()], small, board)
    if pattern is None or not pattern.disturbed:
        return found, ()
    changed = {
        name: replace(view, pixels=pixels, detector=f"{view.detector}:small-window")
        for (name, view), pixels in zip(both.items(), small, strict=True)
    }
    words = (
        f"corners by refinement windows of two sizes differ by {pattern.px:.2f} px rms, and alike "
        f"in all pictures ({pattern.ratio:.0f} times what chance explains): something inside the "
        "squares pulls them, and the small window is used"
    )
    pictures = [read_grey(root / name, name=name) for name in list(both)[:2]]
    dictionary = marker_dictionary(pictures, board)
    if dictionary is None:
        words += "; if the squares hold marks or dirt, use a board without"
    else:
        words += (
            f"; the white squares hold ArUco markers of {dictionary}: declare the board as what it "
            'is, type = "charuco" with dictionary and marker_mm in [board]'
        )
    return found | changed, (words,)


def _inverted(found: Mapping[str, Found]) -> tuple[str, ...]:
    """Say that boards were seen with black and white exchanged."""
    names = [name for name, view in found.items() if view.detector == INVERTED]
    if not names:
        return ()
    named = ", ".join(names[:NAMED]) + (", ..." if len(names) > NAMED else "")
    return (
        f"black and white are exchanged on the ChArUco board in {len(names)} of {len(found)} "
        f"pictures ({named}): it was found in their negatives. Corners are as good; if the board "
        "is printed the usual way, look what inverts the pictures",
    )


class _Search:
    """What one image needs, shared by the threads."""

    def __init__(
        self,
        root: Path,
        board: Board,
        image_size: tuple[int, int],
        detector: str,
        known: Mapping[str, FloatArray],
        sha256: Mapping[str, str],
    ) -> None:
        self._root, self._board, self._size = root, board, image_size
        self._detector, self._known, self._sha256 = detector, known, sha256
        self._own = threading.local()

    def run(self, name: str) -> _Outcome:
        """Return what is in the image `name`."""
        if name in self._known:
            return self._recall(name)
        try:
            grey = read_grey(self._root / name, name=name, sha256=self._sha256.get(name, ""))
        except InputError as error:
            return _Outcome(problem=error.problems[0])
        size = (grey.shape[1], grey.shape[0])
        if size != self._size:
            wanted = f"{self._size[0]} x {self._size[1]}"
            return _Outcome(
                problem=Problem(
                    name,
                    f"the image is {size[0]} x {size[1]} px and the manifest says {wanted}",
                    "correct image_size, or take out images of another camera or mode",
                )
            )
        try:
            return _Outcome(self._find(grey))
        except (cv2.error, MemoryError) as error:
            words = str(error).strip() or type(error).__name__
            return _Outcome(
                problem=Problem(
                    name,
                    f"the search for the board broke down ({words})",
                    "take the image out of the dataset; if there is too little memory, free some",
                )
            )

    def _find(self, grey: Grey) -> Found:
        if self._board.type != "charuco":
            return find_chessboard(grey, self._board, detector=self._detector)
        if not hasattr(self._own, "finder"):
            self._own.finder = CharucoFinder(self._board)
        finder: CharucoFinder = self._own.finder
        return finder.find(grey)

    def _recall(self, name: str) -> _Outcome:
        pixels = self._known[name]
        with np.errstate(invalid="ignore"):
            outside = ((pixels < -0.5) | (pixels > np.array(self._size) - 0.5)).any(axis=-1)
        if outside.any():
            u, v = pixels[outside][0]
            return _Outcome(
                problem=Problem(
                    f"corner cache, image {name}",
                    f"corner ({u:.1f}, {v:.1f}) is outside of {self._size[0]} x {self._size[1]} px",
                    "correct image_size, or delete the cache to detect again",
                )
            )
        return _Outcome(Found(pixels, "cache" if np.isfinite(pixels).any() else "none"))


def _wrong_count(root: Path, found: Mapping[str, Found], board: Board) -> list[Problem]:
    """Return a problem if the pictures show that the board has another number of corners."""
    if board.type != "chessboard" or not found:
        return []
    declared = f"{board.columns} x {board.rows}"
    seen = [name for name, view in found.items() if view.detector != "none"]
    larger = [name for name in seen if found[name].goes_on]
    if len(larger) >= LARGER_MIN and 2 * len(larger) > len(seen):
        return [
            Problem(
                larger[0],
                f"the board goes on beyond {declared} inner corners (in {len(larger)} of "
                f"{len(seen)} pictures)",
                "count the inner corners, where four squares meet, and correct columns and rows "
                "in [board]",
            )
        ]
    if seen:
        return []
    for name in list(found)[:COUNT_TRIED_ON]:
        other = other_count(read_grey(root / name, name=name), board)
        if other is not None:
            return [
                Problem(
                    name,
                    f"no board with {declared} inner corners is in any picture, but one with "
                    f"{other.columns} x {other.rows} is",
                    "correct columns and rows in [board]: count inner corners, where four squares "
                    "meet",
                )
            ]
    return []
