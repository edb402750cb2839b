"""Contact sheets: every picture of a camera with its corners, residuals and what became of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import Corners
from calib.images.contact_sheet import ContactSheet
from calib.images.detection.grid import seen
from calib.images.result import ImageResult
from calib.report.blocks import EMPTY, Cell, PictureSheet, Thumbnail, number
from calib.report.figures.board_pictures import draw_board_picture, enlargement
from calib.report.numbers import decimals
from calib.uncertainty.format import fixed, significant

NOT_FOUND = "none"
LEFT_OUT = "left out: contradicts the others"

USED_SHARE = 0.5
"""A picture of which fewer of the corners are kept counts as left out."""


@dataclass
class _Use:
    """Residuals of a camera's pictures by name, and those that a stage left out."""

    residuals: dict[str, FloatArray] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)


def picture_sheets(images: ImageResult) -> Iterator[PictureSheet]:
    """Return one contact sheet a camera."""
    for camera, sheet in sorted(images.sheets.items()):
        if sheet.names:
            yield _sheet(sheet, images.corners[camera], _use(images, camera))


def _use(images: ImageResult, camera: str) -> _Use:
    """Gather what the stages say of a camera's pictures; the lens counts before pair and sweep."""
    use = _Use()
    if camera == "c2" and images.sweep is not None:
        use.residuals.update(zip(images.sweep.images, images.sweep.residuals, strict=True))
    _pairs(images, camera, use)
    if camera in images.intrinsics:
        found = images.intrinsics[camera]
        use.residuals.update(zip(found.images, found.selected.residuals, strict=True))
        # Of a lens refined with the pairs these are no more among its pictures.
        use.left_out.update(dict.fromkeys(found.rejected_views, LEFT_OUT))
    corners = images.corners[camera]
    known = dict(zip(corners.images, corners.pixels, strict=True))
    for name, residuals in use.residuals.items():
        if name in known and seen(residuals).sum() < USED_SHARE * seen(known[name]).sum():
            use.left_out[name] = LEFT_OUT
    return use


def _pairs(images: ImageResult, camera: str, use: _Use) -> None:
    """Add the residuals of pairs by the solve of record, and the pairs that it left out."""
    if images.stereo is None or not images.stereo.solves:
        return
    which = ("c1", "c2").index(camera)
    solved = images.stereo.solves[0].residuals[which]
    by_stem = dict(zip(images.stereo.stems, solved, strict=True))
    faults = pair_faults(images)
    for stem, names in images.pairs.items():
        if stem in by_stem:
            use.residuals[names[which]] = by_stem[stem]
        else:
            use.left_out[names[which]] = f"pair {stem}: {faults[stem]}"


def pair_faults(images: ImageResult) -> dict[str, str]:
    """Return why pairs were not used, by their common stem."""
    if images.stereo is None:
        return {}
    found = {
        camera: {
            name: bool(seen(pixels).any())
            for name, pixels in zip(corners.images, corners.pixels, strict=True)
        }
        for camera, corners in images.corners.items()
    }
    return {
        stem: LEFT_OUT
        if found["c1"].get(first, False) and found["c2"].get(second, False)
        else "not used: no board found in both"
        for stem, (first, second) in images.pairs.items()
        if stem not in images.stereo.stems
    }


def _sheet(sheet: ContactSheet, corners: Corners, use: _Use) -> PictureSheet:
    known = dict(zip(corners.images, corners.pixels, strict=True))
    every = [r[np.isfinite(r)] for r in use.residuals.values()]
    rms = _rms(np.concatenate(every)) if every else float("nan")
    width, none = corners.image_size[0], np.zeros((0, 2))
    times = enlargement(rms, width) if np.isfinite(rms) else 1.0
    arrows = (
        f" Arrows are residuals, {significant(times)} times enlarged; crosses are corners that "
        "were rejected."
        if np.isfinite(rms)
        else ""
    )
    return PictureSheet(
        key=f"pictures-{sheet.camera}",
        caption=f"All {len(sheet.names)} pictures of {sheet.camera.upper()} with the corners "
        f"found; a click enlarges one.{arrows} Framed: no board found, or left out as the picture "
        "contradicts the others. Corners off their crossings, or a board read from the wrong "
        "end, spoil what follows; a board not found is blurred, too small, or partly covered.",
        pictures=tuple(
            Thumbnail(
                draw_board_picture(
                    grey,
                    corners.image_size,
                    known.get(name, none),
                    use.residuals.get(name),
                    enlarged=times,
                ),
                name,
                detector,
                fault="no board found" if detector == NOT_FOUND else use.left_out.get(name, ""),
                remark=_remark(use.residuals.get(name)),
            )
            for name, detector, grey in zip(
                sheet.names, sheet.detectors, sheet.pictures, strict=True
            )
        ),
    )


def _remark(residuals: FloatArray | None) -> str:
    """Return the residuals of a picture in figures; empty without any."""
    if residuals is None or not np.isfinite(residuals).any():
        return ""
    known = residuals[seen(residuals)]
    largest = float(np.hypot(*known.T).max())
    return f"rms {fixed(_rms(known), 3)} px, largest {fixed(largest, 2)} px"


def residual_cells(residuals: FloatArray | None) -> tuple[Cell, Cell, Cell]:
    """Return corners kept, rms and largest residual of a picture, px."""
    known = np.zeros((0, 2)) if residuals is None else residuals[seen(residuals)]
    if not len(known):
        return number("0", 0.0), EMPTY, EMPTY
    return (
        number(str(len(known)), len(known)),
        decimals(_rms(known), 3),
        decimals(float(np.hypot(*known.T).max()), 2),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
