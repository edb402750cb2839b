"""The boards as they were found."""

from __future__ import annotations

from collections import Counter

import cv2
import numpy as np

from calib.geometry.board import Corners
from calib.images.contact_sheet import ContactSheet
from calib.images.detection.grid import seen
from calib.report.blocks import (
    Block,
    Cell,
    Paragraph,
    PictureSheet,
    Section,
    Thumbnail,
    number,
    table,
    words,
)
from calib.report.context import ReportContext
from calib.report.plotting import data_uri
from calib.results.calibration import Calibration

QUALITY = 80
"""Of the thumbnails' JPEG: corners stay visible, a picture takes some 8 kB."""

NOT_FOUND = "none"


def detection(c: Calibration, _: ReportContext) -> Section | None:
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
    blocks += [
        _sheet(sheet, _left_out(c, camera))
        for camera, sheet in sorted(c.images.sheets.items())
        if sheet.names
    ]
    return Section("detection", "Boards in the pictures", tuple(blocks))


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


def _left_out(c: Calibration, camera: str) -> frozenset[str]:
    """Return the pictures of a camera of which the intrinsics rejected most corners."""
    if camera not in c.images.intrinsics:
        return frozenset()
    found = c.images.intrinsics[camera]
    known = seen(c.images.corners[camera].select(found.images).pixels).sum(axis=-1)
    kept = seen(found.selected.residuals).sum(axis=-1)
    return frozenset(found.images[i] for i in np.flatnonzero(2 * kept < known))


def _sheet(sheet: ContactSheet, rejected: frozenset[str]) -> PictureSheet:
    left_out = f"; {sheet.left_out} more are not shown" if sheet.left_out else ""
    return PictureSheet(
        key=f"pictures-{sheet.camera}",
        caption=f"Pictures of {sheet.camera.upper()} with the corners found{left_out}. Corners off "
        "their crossings, or a board read from the wrong end, spoil what follows; a board not "
        "found is blurred, too small, or partly covered.",
        pictures=tuple(
            Thumbnail(_jpeg(picture), name, detector, fault=_fault(name, detector, rejected))
            for name, detector, picture in zip(
                sheet.names, sheet.detectors, sheet.pictures, strict=True
            )
        ),
    )


def _fault(name: str, detector: str, rejected: frozenset[str]) -> str:
    """Return why a picture is framed; empty for one that is used."""
    if detector == NOT_FOUND:
        return "no board found"
    return "left out: contradicts the others" if name in rejected else ""


def _jpeg(picture: np.ndarray) -> str:
    _, encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return data_uri("image/jpeg", encoded.tobytes())
