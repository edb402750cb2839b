"""The intrinsics of both cameras, by both backends."""

from __future__ import annotations

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.board import LensFit
from calib.geometry.camera import Camera
from calib.geometry.lens import PROJECTIONS
from calib.images.intrinsics.calibrate import Intrinsics
from calib.images.intrinsics.maps import Coverage, fit_name
from calib.report.blocks import (
    EMPTY,
    Block,
    Cell,
    Chapter,
    DefinitionList,
    Fold,
    Paragraph,
    Table,
    facts,
    number,
    table,
    words,
)
from calib.report.context import ReportContext
from calib.report.figures.intrinsics import (
    draw_coverage,
    draw_cross_validation,
    draw_difference,
    draw_residuals,
)
from calib.report.numbers import decimals, digits, estimate, signed
from calib.report.plotting import picture
from calib.report.sections.board_pictures import LEFT_OUT
from calib.results.calibration import Calibration
from calib.uncertainty.format import fixed, significant

FOLDED_RMS_PX = 1e4
"""Beyond the size of pictures, the figures of an rms say no more."""

DIFFERENCES_DRAWN = 2
"""The first ones: the other backend, and the splined lens model."""


def intrinsics(c: Calibration, _: ReportContext) -> Chapter | None:
    """Write the intrinsics."""
    if not c.images.intrinsics:
        return None
    blocks: list[Block] = [
        Paragraph(
            "Each camera was calibrated from its pictures of the board by OpenCV and by mrcal, "
            "each with several lens models. The lens model is the simplest that no larger one "
            "beats in predicting views that were left out; rms is the root mean square residual "
            "per coordinate, the same for all. Where pictures show a wide lens, an equidistant "
            "one (fisheye) is solved by this program and by OpenCV; mrcal has no such model, only "
            "a splined one beside it. Where there are stereo pairs, a joint solve of "
            "both lenses, the pairs and the boards of the gaze rows then refines lens and pose."
        )
    ]
    for name, found in sorted(c.images.intrinsics.items()):
        blocks += _camera(found, c.images.corners[name].select(found.images).pixels)
    return Chapter("intrinsics", "Intrinsics", tuple(blocks))


def _camera(i: Intrinsics, corners: FloatArray) -> list[Block]:
    name = i.name.upper()
    used = np.where(np.isfinite(i.selected.residuals), corners, np.nan)
    differences = [
        picture(
            f"difference-{i.name}-{k + 1}",
            draw_difference(i, d),
            f"{name}: {_short(d.second)} less {_short(d.first)}. Left, in pixels (arrows: where "
            "to; long ones are cut); right, over what both stated uncertainties lead to expect: "
            "above 2 over a large part of the imager, one of the two is wrong by more than it "
            "says, or the lens model does not fit the lens.",
        )
        for k, d in enumerate(i.differences[:DIFFERENCES_DRAWN])
    ]
    return [
        _fits(i),
        _facts(i),
        picture(
            f"coverage-{i.name}",
            draw_coverage(i, used),
            f"{name}: where corners were, and the standard deviation of where a ray is projected "
            "(× where no corner is near). Empty corners of the imager are extrapolated by the lens "
            "model; uncertainty that grows steeply towards an edge asks for boards there.",
        ),
        picture(
            f"residuals-{i.name}",
            draw_residuals(i, corners),
            f"{name}: residuals of the selected fit. They should point everywhere: arrows that "
            "agree with their neighbours are a lens model that does not fit, a board that is not "
            "flat, or pictures taken in motion.",
        ),
        *differences,
        _difference_table(i),
        picture(
            f"left-out-{i.name}",
            draw_cross_validation(i),
            f"{name}: residual of each view when the fit had not seen it. One view far above the "
            "others is a bad picture; all far above the fitted rms is too few views.",
        ),
        _validation(i),
        Fold(f"All {len(_named(i))} pictures of {name} by name", (_pictures(i, corners),)),
    ]


def _pictures(i: Intrinsics, corners: FloatArray) -> Table:
    """Return each picture by name with its corners and residuals."""
    found = np.isfinite(corners).all(axis=-1).sum(axis=-1)
    kept = np.isfinite(i.selected.residuals).all(axis=-1).sum(axis=-1)
    rows = [
        (
            words(image),
            number(str(int(found[k])), int(found[k])),
            number(str(int(found[k] - kept[k])), int(found[k] - kept[k])),
            decimals(_rms_of(i.selected.residuals[k]), 3),
            decimals(_largest(i.selected.residuals[k]), 2),
            _state(int(found[k]), int(kept[k])),
        )
        for k, image in enumerate(i.images)
    ]
    rows += [
        (words(name), EMPTY, EMPTY, EMPTY, EMPTY, words(LEFT_OUT, mark="bad"))
        for name in i.rejected_views
        if name not in i.images
    ]
    heads = ("Picture", "Corners", "Rejected", "rms / px", "Largest residual / px", "Used")
    return table(
        f"Pictures of {i.name.upper()}",
        heads,
        rows,
        note=f'A picture that spoils more than it tells is left out by exclude = ["..."] in '
        f"[cameras.{i.name}], by the name given here.",
        sortable=True,
    )


def _named(i: Intrinsics) -> tuple[str, ...]:
    """Return all pictures of the board, those that were rejected before the refinement included."""
    return tuple(dict.fromkeys((*i.images, *i.rejected_views)))


def _rms_of(residuals: FloatArray) -> float:
    known = residuals[np.isfinite(residuals)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def _largest(residuals: FloatArray) -> float:
    known = residuals[np.isfinite(residuals).all(axis=-1)]
    return float(np.hypot(*known.T).max()) if len(known) else float("nan")


def _state(found: int, kept: int) -> Cell:
    """Return whether a picture is used."""
    if not found:
        return words("no board found", mark="caution")
    if 2 * kept < found:
        return words(LEFT_OUT, mark="bad")
    return words("yes")


def _fits(i: Intrinsics) -> Table:
    fits = [(i.selected, i.covariance), *((fit, fit.covariance) for fit in i.alternatives)]
    rows = []
    for k, name in enumerate(("fx / px", "fy / px", "cx / px", "cy / px")):
        row, column = divmod((0, 4, 2, 5)[k], 3)
        rows.append(
            [
                words(name),
                *(
                    estimate(fit.camera.matrix[row, column], float(np.sqrt(covariance[k, k])))
                    for fit, covariance in fits
                ),
            ]
        )
    rows += [
        [words("rms / px"), *(decimals(fit.rms_px, 3) for fit, _ in fits)],
        [words("Corners rejected"), *(number(str(f.rejected), f.rejected) for f, _ in fits)],
        [words("Deformation of the board / mm"), *(_warp(fit) for fit, _ in fits)],
    ]
    heads = ["", f"{_short(fit_name(i.selected))} (selected)"]
    heads += [_short(fit_name(fit)) for fit in i.alternatives]
    return table(
        f"Fits of {i.name.upper()}, ± standard uncertainty",
        heads,
        rows,
        note="Each is multiplied by a factor, that of the selected fit by "
        f"{significant(i.dispersion**0.5)}: how far the views disagree with each other, over what "
        "the noise of their corners explains. Deformation: at the middle, along the columns "
        "and rows of the board.",
    )


def _rms(value: float) -> Cell:
    """Return an rms; of a lens that folds back inside the picture it has no bounds."""
    return decimals(value, 3) if value < FOLDED_RMS_PX else words(f"over {FOLDED_RMS_PX:g}")


def _short(name: str) -> str:
    """Return the name of a fit without mrcal's prefix."""
    return name.replace("LENSMODEL_", "")


def _mrcal(version: str | None) -> str:
    if version is None:
        return "not available: OpenCV alone"
    return "of unknown version" if version == "unknown" else f"version {version}"


def _warp(fit: LensFit) -> Cell:
    if fit.board_warp_mm is None:
        return EMPTY
    x, y = (signed(fixed(v, 2)) for v in fit.board_warp_mm)
    return number(f"{x}, {y}", fit.board_warp_mm[0])


def _order(camera: Camera) -> str:
    """Return of which lens model coefficients are."""
    if camera.projection == "perspective":
        return "order of OpenCV"
    return f"{PROJECTIONS[camera.projection].words}, as cv2.fisheye has them"


def _facts(i: Intrinsics) -> DefinitionList:
    lens = ", ".join(digits(float(k), 4).text for k in i.camera.distortion) or "none"
    return facts(
        ("Selected because", i.selection),
        ("Lens distortion, selected", f"{lens} ({_order(i.camera)})"),
        ("Views", f"{len(_named(i))}, of which {len(i.rejected_views)} rejected"),
        ("Rejected views", ", ".join(i.rejected_views)),
        ("Coverage", _coverage(i.coverage)),
        ("mrcal", _mrcal(i.mrcal_version)),
    )


def _coverage(coverage: Coverage) -> str:
    """Return where corners were seen: a cell counts with one corner, wherever in it that is."""
    down, across = coverage.counts.shape
    seen = int((coverage.counts > 0).sum())
    text = (
        f"corners in {seen} of {down * across} cells of the imager ({across} × {down}), out to "
        f"{100 * coverage.reach:.0f} % of its half diagonal"
    )
    return f"{text}; beyond, the lens model extrapolates" if coverage.reach < 1 else text


def _difference_table(i: Intrinsics) -> Table:
    rows = [
        (
            words(_short(d.second)),
            digits(d.rms_px, 2),
            digits(d.expected_rms_px, 2),
            digits(d.ratio, 2),
            digits(d.max_px, 2),
        )
        for d in i.differences
    ]
    heads = (
        "Other calibration",
        "Difference, rms / px",
        "Expected, rms / px",
        "Difference / expected",
        "At most / px",
    )
    return table(f"{i.name.upper()}: other calibrations less the selected one", heads, rows)


def _validation(i: Intrinsics) -> Table:
    v = i.validation
    rows = [
        (
            words(f"{lens} (chosen)" if lens == v.chosen else lens),
            _rms(float(out)),
            _rms(float(fitted)),
        )
        for lens, out, fitted in zip(v.lenses, v.rms_px, v.fitted_rms_px, strict=True)
    ]
    heads = ("Lens model", "rms of views left out / px", "rms of the same views fitted / px")
    fx, fy, cx, cy = (significant(float(s), digits=2) for s in v.std_jackknife)
    return table(
        f"{i.name.upper()}: cross-validation",
        heads,
        rows,
        note=f"Leaving views out moves fx, fy, cx, cy of the chosen lens by {fx}, {fy}, {cx}, {cy} "
        "px (delete-a-group jackknife, one standard deviation).",
    )
