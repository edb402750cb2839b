"""A picture of a board with its corners and residuals: SVG over a small grey copy."""

from __future__ import annotations

from urllib.parse import quote

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.core.arrays import FloatArray
from calib.images.detection.grid import seen
from calib.report.plotting import BLUE, ORANGE, VERMILLION, data_uri

QUALITY = 72
"""Of the JPEG: a board's edges stay clear, a picture 640 px wide takes some 25 kB."""

ARROW_SHARE = 0.02
"""Share of the picture's width that an arrow of the root mean square length takes."""

_SAFE = " =:/;,+'()!*@&?~$-_."
"""Characters that stay as they are in the URI: the JPEG inside is not encoded twice."""


def enlargement(rms_px: float, width_px: int) -> float:
    """Return by how much residuals are enlarged, 1, 2 or 5 times a power of ten."""
    wanted = ARROW_SHARE * width_px / max(rms_px, 1e-6)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted))


def draw_board_picture(
    grey: NDArray[np.uint8],
    size: tuple[int, int],
    corners: FloatArray,
    residuals: FloatArray | None,
    *,
    enlarged: float,
) -> str:
    """Return the data URI of a picture with its corners marked and its residuals as arrows.

    Parameters
    ----------
    grey
        Copy of the picture, any size, shape (height, width).
    size
        Width and height of the picture itself, px.
    corners
        In board order, px, shape (corners, 2); NaN where missing. The first is marked larger.
    residuals
        Observed minus projected, px, shape (corners, 2), NaN where rejected; None where no fit
        has used the picture.
    enlarged
        Times that residuals are drawn longer.
    """
    width, height = size
    _, encoded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    place = f"x='-.5' y='-.5' width='{width}' height='{height}'"
    radius = width / 160
    found = seen(corners)
    rejected = np.zeros_like(found)
    arrows = ""
    if residuals is not None:
        kept = seen(residuals) & found
        rejected = found & ~kept
        arrows = _path(_lines(corners[kept], enlarged * residuals[kept]), ORANGE, 0.4 * radius)
    marks = _path(_rings(corners[found & ~rejected], radius), BLUE, 0.3 * radius)
    marks += _path(_crosses(corners[rejected], radius), VERMILLION, 0.5 * radius)
    first = _path(_rings(corners[:1][found[:1]], 2 * radius), VERMILLION, 0.5 * radius)
    opening = (
        f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='-.5 -.5 {width} {height}' "
        f"width='{width}' height='{height}'><image {place} href='"
    )
    closing = f"'/>{marks}{first}{arrows}</svg>"
    # The JPEG's own URI has no character to encode, and is most of the text.
    jpeg = data_uri("image/jpeg", encoded.tobytes())
    return f"data:image/svg+xml,{quote(opening, safe=_SAFE)}{jpeg}{quote(closing, safe=_SAFE)}"


def _path(steps: str, colour: str, stroke: float) -> str:
    if not steps:
        return ""
    return f"<path fill='none' stroke='{colour}' stroke-width='{stroke:.2g}' d='{steps}'/>"


def _rings(at: FloatArray, r: float) -> str:
    turn = f"a{r:.3g} {r:.3g} 0 1 0 {2 * r:.3g} 0a{r:.3g} {r:.3g} 0 1 0 {-2 * r:.3g} 0"
    return "".join(f"M{u - r:.1f} {v:.1f}{turn}" for u, v in at)


def _crosses(at: FloatArray, r: float) -> str:
    both = f"l{2 * r:.3g} {2 * r:.3g}m0 {-2 * r:.3g}l{-2 * r:.3g} {2 * r:.3g}"
    return "".join(f"M{u - r:.1f} {v - r:.1f}{both}" for u, v in at)


def _lines(at: FloatArray, vectors: FloatArray) -> str:
    """Return arrows: a shaft from each point, with a head of a third of its length."""
    parts = []
    for (u, v), (du, dv) in zip(at, vectors, strict=True):
        back, aside = (-0.3 * du, -0.3 * dv), (-0.15 * dv, 0.15 * du)
        left = (back[0] + aside[0], back[1] + aside[1])
        right = (back[0] - aside[0], back[1] - aside[1])
        parts.append(
            f"M{u:.1f} {v:.1f}l{du:.1f} {dv:.1f}l{left[0]:.1f} {left[1]:.1f}"
            f"m{-left[0]:.1f} {-left[1]:.1f}l{right[0]:.1f} {right[1]:.1f}"
        )
    return "".join(parts)
