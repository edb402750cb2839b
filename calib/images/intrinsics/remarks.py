"""What the reader of intrinsics should know of pictures and backends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.core.errors import EstimationError
from calib.geometry.board import Board, Corners, LensFit
from calib.images.bundle import deformed
from calib.images.detection.marks import PATTERN_RATIO, on_board, repeated_pattern
from calib.images.intrinsics.by_mrcal import MrcalFits
from calib.images.intrinsics.gates import WORSE
from calib.images.intrinsics.maps import fit_name
from calib.images.intrinsics.rolling_shutter import rolling_shutter

FEWER = 0.02
"""Share of the selected fit's corners that another one may lack and still be set beside it."""


def better(first: LensFit | None, second: LensFit | None) -> tuple[LensFit, str]:
    """Return the first fit unless the second is better by far, and why it is not the first.

    Raises
    ------
    EstimationError
        If there is neither.
    """
    if first is None or second is None:
        only = second if first is None else first
        if only is None:
            raise EstimationError("no backend solved the lens model that was selected")
        return only, ""
    if first.rms_px <= WORSE * second.rms_px:
        return first, ""
    return second, (
        f"{first.backend} ended at {first.rms_px:.3f} px rms and {second.backend} at "
        f"{second.rms_px:.3f} px with the same lens model: that of {second.backend} is used"
    )


def other_fits_better(selected: LensFit, others: Sequence[LensFit]) -> tuple[str, ...]:
    """Say which other fits leave less on the same corners than the selected one, by `WORSE`.

    Of fits that use as many corners, but for `FEWER`: what a fit rejects it need not explain.
    """
    said = []
    for other in others:
        used, theirs = np.isfinite(selected.residuals), np.isfinite(other.residuals)
        both = used & theirs
        if used.shape != theirs.shape or both.sum() < (1 - FEWER) * used.sum():
            continue
        ours, less = (float(np.sqrt(np.mean(f.residuals[both] ** 2))) for f in (selected, other))
        if ours > WORSE * less:
            said.append(f"{fit_name(other)} {less:.3f} px")
    if not said:
        return ()
    return (
        f"the selected fit ({fit_name(selected)}) leaves {selected.rms_px:.3f} px rms, other lens "
        f"models less on the same corners: {', '.join(said)}; they do not predict left-out views "
        "better, so more pictures, with corners at the rim, must tell",
    )


def picture_warnings(
    camera: str, corners: Corners, repeated: tuple[str, ...], inconsistent: tuple[str, ...]
) -> tuple[str, ...]:
    """Say what became of pictures that are not used."""
    warnings = []
    missed = [
        name for name, who in zip(corners.images, corners.detector, strict=True) if who == "none"
    ]
    if missed:
        warnings.append(
            f"{camera}: no board found in {len(missed)} of {len(corners.images)} intrinsic images "
            f"({', '.join(missed)})"
        )
    if repeated:
        warnings.append(f"{camera}: repeats of other images are not used: {', '.join(repeated)}")
    if inconsistent:
        warnings.append(
            f"{camera}: most corners of {', '.join(inconsistent)} contradict the other images "
            "and were left out: look whether such a picture is blurred, turned, scaled, or taken "
            "with another focus or camera, and name it in exclude = [...] of "
            f"[cameras.{camera}]"
        )
    return tuple(warnings)


def backend_warnings(camera: str, mrcal: MrcalFits) -> tuple[str, ...]:
    """Say which solves are missing."""
    if mrcal.missing:
        return (f"{camera}: {mrcal.missing}",)
    return tuple(f"{camera}: mrcal, {lens}: {why}" for lens, why in mrcal.failed.items())


def fit_warnings(camera: str, fit: LensFit, corners: Corners, board: Board) -> tuple[str, ...]:
    """Say what the residuals have in common: in all pictures alike, or within each."""
    return (
        *board_warning(camera, fit, corners, board),
        *_rolling_warning(camera, fit, corners, board),
    )


def _rolling_warning(camera: str, fit: LensFit, corners: Corners, board: Board) -> tuple[str, ...]:
    """Say that boards moved before a rolling shutter."""
    points = deformed(board.object_points(), fit.board_warp_mm)
    found = rolling_shutter(fit, corners.pixels, points)
    if found is None or not found.told:
        return ()
    return (
        f"{camera}: each picture shows the board sheared or stretched in its own way, by "
        f"{found.motion_px:.1f} px over the height of the picture, {100 * found.share:.0f} % of "
        "all that the lens leaves of the corners: boards moved while a rolling shutter read the "
        "rows of the picture. The uncertainty contains what views contradict each other; put the "
        "board on a stand, or use a camera with a global shutter",
    )


def board_warning(camera: str, fit: LensFit, corners: Corners, board: Board) -> tuple[str, ...]:
    """Say that corners lie off their places on the board, where all pictures show them so."""
    views = zip(corners.pixels, fit.residuals, strict=True)
    off = np.array([on_board(pixels, left, board) for pixels, left in views])
    pattern = repeated_pattern(off)
    if pattern is None or pattern[1] < PATTERN_RATIO:
        return ()
    spacings, ratio = pattern
    return (
        f"{camera}: corners lie {spacings * board.square_mm:.3f} mm rms off their places on the "
        f"board, alike in all pictures ({ratio:.0f} times what chance explains): the print or the "
        "plate is not true. The covariance of the intrinsics holds what that may do; a board on "
        "glass or metal does better",
    )
