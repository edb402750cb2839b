"""Where the reference depths of captured rows come from: a hand, the board's squares, or pairs.

A depth read off a ruler is typed in. The squares of a board that both cameras picture give the
scale by themselves. A pair of pictures, C2 held at one reading, gives the depth by triangulation;
its row names it in the column ``stereo``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath
from typing import Any, Final, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from calib.capture.description import Description, Kind
from calib.capture.guidance.need import need_for
from calib.capture.guidance.pairs import holding_reading
from calib.capture.stereo import FOLDERS, SAME_DEG
from calib.capture.writer import GrowingFolder
from calib.core.arrays import FloatArray
from calib.core.errors import UsageError
from calib.dataset.manifest import Manifest
from calib.gaze.gazing import TIMEOUT_S, Gazer
from calib.gaze.placing import Placing
from calib.gaze.target import BoardCorner, board_corners
from calib.geometry.board import Board
from calib.geometry.camera import Camera
from calib.geometry.poses import transform
from calib.images.bundle import finite
from calib.images.pairs import single_view_pose
from calib.rig.devices import RigDevices
from calib.rig.protocols import Frame, Refused, RigError, Standstill

Source: TypeAlias = Literal["hand", "squares", "pairs"]
SOURCES: Final[tuple[Source, ...]] = ("hand", "squares", "pairs")

WORDS: Final[Mapping[Source, str]] = {
    "squares": "squares of the board",
    "pairs": "stereo pairs, C2 held",
}
"""What the manifest calls them."""


CORNERS_MIN: Final = 8
"""Corners of a board that a picture must show for its pose."""


@dataclass(frozen=True)
class Depth:
    """The reference depth of a target.

    Parameters
    ----------
    z_mm
        As well as it is known before the calibration, mm.
    cells
        What the row says of it.
    pictures
        To be written with the row, by name.
    tables
        What the manifest must say for the cells to mean something.
    """

    z_mm: float
    cells: Mapping[str, str]
    pictures: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)
    tables: Mapping[str, Any] = field(default_factory=dict)


class Reference(Protocol):
    """Measures the depths of targets by other means than gazing."""

    def depth(self, name: str) -> Depth:
        """Return the depth of the target that stands there.

        Raises
        ------
        RigError
            If there is none to be had.
        """


@dataclass(frozen=True)
class ByHand:
    """Depths measured by hand; `u_z_mm` where the hand states no uncertainty."""

    hand: Placing
    u_z_mm: float

    def depth(self, name: str) -> Depth:
        """Ask for the depth."""
        found = self.hand.depth_mm(name)
        if found is None:
            raise RigError(f"{name}: there is no depth")
        z, u = found[0], self.u_z_mm if found[1] is None else found[1]
        return Depth(z, {"z_mm": f"{z:.10g}", "u_z_mm": f"{u:.10g}"})


@dataclass(frozen=True)
class BySquares:
    """Depths by the board in C1's picture: the calibration finds them again, with their u."""

    gazer: Gazer
    board: Board
    lens_c1: Camera

    def depth(self, name: str) -> Depth:  # noqa: ARG002 - of the protocol
        """Look by C1."""
        frame = self.gazer.rig.c1.after(self.gazer.rig.clock.now_ns(), timeout_s=TIMEOUT_S)
        pixels = _corners(frame, self.board)
        return Depth(_depth_by_squares(pixels, self.board, self.lens_c1), {})


@dataclass(frozen=True)
class ByPairs:
    """Depths by pairs of pictures, C2 held at one reading.

    Parameters
    ----------
    held_rad
        The reading, rad.
    folder
        Where the pairs go.
    """

    gazer: Gazer
    board: Board
    lens_c1: Camera
    held_rad: float
    folder: GrowingFolder

    def depth(self, name: str) -> Depth:  # noqa: ARG002 - of the protocol
        """Turn C2 to the reading and take a pair."""
        standing = self._held()
        moment = self.gazer.at_rest(standing)
        frames = {
            "c1": self.gazer.rig.c1.after(moment, timeout_s=TIMEOUT_S),
            "c2": self.gazer.rig.c2.after(moment, timeout_s=TIMEOUT_S),
        }
        self.gazer.refuse_turned(standing)
        pixels = {role: _corners(frame, self.board) for role, frame in frames.items()}
        if pixels["c2"] is None:
            raise Refused(
                "C2 does not see the board from the reading at which pairs are taken, "
                f"{math.degrees(self.held_rad):.3f} deg; move the target"
            )
        picture = PurePosixPath(self.folder.next_picture(FOLDERS["c2"])).name
        reading = round(math.degrees(standing.reading_rad), 9)
        patterns = {role: f"{under}/*.png" for role, under in FOLDERS.items()}
        return Depth(
            z_mm=_depth_by_squares(pixels["c1"], self.board, self.lens_c1),
            cells={"stereo": PurePosixPath(picture).stem},
            pictures={
                f"{FOLDERS['c1']}/{picture}": frames["c1"].pixels,
                f"{FOLDERS['c2']}/{picture}": frames["c2"].pixels,
            },
            tables={"stereo": {**patterns, "alpha2_deg": reading}},
        )

    def _held(self) -> Standstill:
        standing = self.gazer.stand_at(self.held_rad)
        off = math.degrees(abs(standing.reading_rad - self.held_rad))
        if off > math.degrees(self.gazer.rig.axis.resolution_rad) + SAME_DEG:
            raise Refused(
                f"C2 came to rest {off:.6f} deg beside the reading at which pairs are taken; is "
                "the axis homed, does it arrive?"
            )
        return standing


def source_of(manifest: Manifest | None, kind: Kind, asked: Source | None) -> Source:
    """Return where the depths of a table come from: as asked for, as begun, or by hand.

    Raises
    ------
    UsageError
        If rows of the table have theirs from elsewhere, or the table is of validation and the
        squares are asked for: they are what the calibration rows stand on.
    """
    section = None if manifest is None else getattr(manifest, kind)
    begun: Source | None = None
    if section is not None:
        begun = next((s for s, words in WORDS.items() if section.reference == words), "hand")
    if asked is not None and begun is not None and asked != begun:
        raise UsageError(
            f"--reference {asked}: the rows of [{kind}] have their depths by {begun}; leave the "
            "option out, or capture into a new folder"
        )
    source = asked or begun or "hand"
    if source == "squares" and kind == "validation":
        raise UsageError(
            "--reference squares: validation rows need a depth that calibration rows have not; "
            "measure by hand, or by pairs"
        )
    return source


def described(known: Description, source: Source) -> Description:
    """Return the description of rows with such depths."""
    if source == "hand":
        return known
    return replace(known, reference=WORDS[source], z_from_c1=True)


def held_reading(rig: RigDevices, manifest: Manifest | None) -> float:
    """Return the reading at which pairs are taken, rad: that of the pairs there are, or the middle.

    Raises
    ------
    UsageError
        If nothing says it.
    """
    if manifest is not None and manifest.stereo is not None:
        stated = manifest.stereo.alpha2_deg
        if stated is None or not manifest.stereo.has_images:
            raise UsageError(
                "--reference pairs: [stereo] of the dataset has no pairs; capture into a new folder"
            )
        return math.radians(stated)
    baseline = rig.settings.nominal_baseline_mm
    if baseline is None:
        raise UsageError(
            "--reference pairs: rig.toml states no baseline_mm, by which C2 is held where both "
            "cameras see the targets; measure it by tape"
        )
    depths = None if rig.world is None else rig.world.rig.depth_range_mm
    need = need_for(tolerance=None, depths_mm=depths, baseline_mm=baseline)
    counts = rig.axis.resolution_rad
    return float(round(holding_reading(need, baseline) / counts) * counts)


def reference_for(
    source: Source,
    *,
    by_hand: Callable[[], ByHand],
    gazer: Gazer,
    known: Description,
    lens_c1: Camera | None,
    held_rad: float | None,
    folder: GrowingFolder,
) -> Reference:
    """Return the reference of a source.

    Raises
    ------
    UsageError
        If the target is no board that the chain finds again, or C1's lens is not known.
    """
    if source == "hand":
        return by_hand()
    target = gazer.target
    if not isinstance(target, BoardCorner) or target.board != known.board:
        raise UsageError(f"--reference {source}: needs the board as the target; leave --target out")
    if lens_c1 is None:
        raise UsageError(
            f"--reference {source}: C1's lens is not known; add matrix and distortion to "
            "[cameras.c1] of rig.toml, or run `calib capture intrinsics` into this dataset first"
        )
    if source == "squares" or held_rad is None:
        return BySquares(gazer, target.board, lens_c1)
    return ByPairs(gazer, target.board, lens_c1, held_rad, folder)


def _corners(frame: Frame, board: Board) -> FloatArray | None:
    """Return the corners in a picture, px, (corners, 2); None without target or enough of them."""
    pixels = board_corners(frame.pixels, board)
    seen = finite(pixels)
    return pixels if seen[board.target_index] and seen.sum() >= CORNERS_MIN else None


def _depth_by_squares(pixels: FloatArray | None, board: Board, lens: Camera) -> float:
    """Return the depth of the target corner, mm, by the board's corners in C1."""
    if pixels is None:
        raise Refused("C1 does not see the board; is it in the picture, sharp, evenly lit?")
    points = board.object_points()
    pose, _ = single_view_pose(lens, points=points, pixels=pixels)
    return float(transform(pose, points[[board.target_index]])[0, 2])
