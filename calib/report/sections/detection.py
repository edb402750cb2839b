"""The boards as they were found."""

from __future__ import annotations

from collections import Counter

from calib.geometry.board import Corners
from calib.images.detection.grid import seen
from calib.report.blocks import (
    Block,
    Cell,
    Chapter,
    Paragraph,
    number,
    table,
    words,
)
from calib.report.context import ReportContext
from calib.report.sections.board_pictures import NOT_FOUND, picture_sheets
from calib.results.calibration import Calibration


def detection(c: Calibration, _: ReportContext) -> Chapter | None:
    """Write the detection of boards."""
    if not c.images.corners:
        return None
    rows = [_row(camera, corners) for camera, corners in sorted(c.images.corners.items())]
    blocks: list[Block] = [
        Paragraph(
            "The board's inner corners were sought in every picture, each once. The pictures below "
            "show what was found: the first corner is marked larger, and must sit at the same end "
            "of the board in all pictures of a pair."
        ),
        table(
            "Boards found",
            ("Camera", "Image / px", "Pictures", "Boards found", "Corners", "Found by"),
            rows,
        ),
    ]
    blocks += picture_sheets(c.images)
    return Chapter("detection", "Boards in the pictures", tuple(blocks))


def _row(camera: str, corners: Corners) -> tuple[Cell, ...]:
    found = seen(corners.pixels)
    boards, total = int(found.any(axis=-1).sum()), len(corners.images)
    width, height = corners.image_size
    who = Counter(name for name in corners.detector if name != NOT_FOUND)
    told = ", ".join(f"{name} {count}" for name, count in who.most_common())
    return (
        words(camera.upper()),
        words(f"{width} × {height}"),
        number(str(total), total),
        number(str(boards), boards, mark="" if boards == total else "caution"),
        number(str(int(found.sum())), int(found.sum())),
        words(told or "–"),
    )
