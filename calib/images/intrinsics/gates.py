"""What must hold before intrinsics may be used, and what a reader should be told besides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.gate import Gate
from calib.geometry.board import LensFit
from calib.geometry.poses import rotation
from calib.images.bundle import finite
from calib.images.checks import fit_gate, gate
from calib.images.intrinsics.maps import Coverage, LensDifference, LensMap
from calib.images.intrinsics.validate import CrossValidation

COVERAGE_MIN = 0.5
"""Share of the imager's cells that must hold corners: the lens model is only interpolated between
corners. Thirteen pictures of a hand-held board (OpenCV's) cover 0.67 to 0.71; boards kept in the
middle of the picture 0.2 to 0.3."""

COVERAGE_LEAST = 0.3
"""Share that will do where the projection is certain on them (`FIELD_STD_MAX`): then the pictures
show what they need to, and whether rows look farther out is asked of the rows."""

FIELD_STD_MAX = 0.002
"""Standard deviation of the projection, rms over the field in use, in parts of the focal length:
about what a row's gaze is good to (Xu and Wang's encoder steps 0.6 mrad)."""

CROSS_VALIDATION_MAX = 1.3
"""A view left out over the same view fitted, rms, in the median view. Good pictures give 1.01 at 20
views and 1.1 at 6. Above, the lens follows noise, or there are too few."""

FOCAL_STD_MAX = 0.005
"""Relative standard uncertainty of the focal length. Depth inherits it; a usual set of 20 tilted
views reaches 0.001, boards parallel to the imager 0.05 and worse."""

TILT_SPREAD_MIN_DEG = 4.0
"""Root mean square angle of the boards' normals about their mean. Corner noise alone scatters the
normals of parallel boards by one or two degrees, hand-held boards by 15 to 30."""

PARALLEL_DEG = 15.0
"""A mean normal this near the optical axis is called parallel to the imager."""

ONE_PLACE = 0.1
"""Scatter of the board's place, over its distance, below which it stood at one place; boards moved
all over the picture scatter by 0.4."""

AGREEMENT_MAX = 1.0
"""Backends see the same corners, so they must agree within what each says it does not know."""

AGREEMENT_MAX_PX = 1.0
"""And within this over the covered imager, whatever they say: a solve that failed knows nothing and
says so."""

FLAT_MAX_PX = 2.0
"""By this at most may OpenCV on the board as drawn differ: a warp of 0.5 mm of a board of 300 mm
makes 1 px of a lens of 800 px."""

WORSE = 1.1
"""Ratio of rms by which the fit of record may be worse than another one of the same corners."""

DISPERSION_WARN = 2.0
"""Variance between views over that of corner noise: twenty views of pure noise give 1.0 +- 0.2."""

SPLINE_WARN = 2.0
"""Difference to a splined lens over the uncertainty of both."""


LEFT_OUT_LIMIT = 0.2
"""Share of the pictures that may be left out whole without their corners counting as rejected. A
few blurred or turned pictures spoil nothing once they are out; where a fifth and more contradict
the others, it is open which of them are right."""

NAMED = 5
"""Pictures that are named at most."""


@dataclass(frozen=True)
class LeftOutPictures:
    """Pictures of which a fit rejected most corners, and the number of those corners."""

    images: tuple[str, ...]
    corners: int


def views_left_out(
    images: tuple[str, ...], pixels: FloatArray, residuals: FloatArray
) -> LeftOutPictures:
    """Return the images of which a fit rejected over half of the corners.

    Parameters
    ----------
    pixels, residuals
        Corners found, and residuals of those used, px, shape (views, corners, 2); NaN elsewhere.
    """
    found, kept = finite(pixels).sum(axis=-1), finite(residuals).sum(axis=-1)
    out = np.flatnonzero(2 * kept < found)
    return LeftOutPictures(tuple(images[i] for i in out), int((found - kept)[out].sum()))


def orientation_fault(poses: FloatArray) -> str | None:
    """Return what is wrong with how the boards were held, if they hardly differ in tilt.

    Parameters
    ----------
    poses
        Camera from board, rad and mm, shape (views, 6); NaN where there is none.
    """
    known = poses[finite(poses)]
    normals = np.stack([rotation(pose[:3])[:, 2] for pose in known])
    mean = normals.mean(axis=0)
    mean /= np.linalg.norm(mean)
    angles = np.degrees(np.arccos(np.clip(normals @ mean, -1, 1)))
    spread = float(np.sqrt(np.mean(angles**2)))
    if spread >= TILT_SPREAD_MIN_DEG:
        return None
    tilt = float(np.degrees(np.arccos(min(1.0, abs(mean[2])))))
    if _at_one_place(known):
        what = "the board stood at one place in one attitude"
    elif tilt < PARALLEL_DEG:
        what = "all boards are parallel to the imager"
    else:
        what = "all boards are parallel to each other"
    return f"{what} (tilts differ by {spread:.1f} deg rms, {TILT_SPREAD_MIN_DEG:g} are needed)"


def _at_one_place(poses: FloatArray) -> bool:
    """Whether the boards of finite poses, shape (n, 6), stand at one place."""
    where = poses[:, 3:]
    scatter = np.linalg.norm(where.std(axis=0)) / np.linalg.norm(where.mean(axis=0))
    return bool(scatter < ONE_PLACE)


def intrinsics_gates(
    name: str,
    fit: LensFit,
    coverage: Coverage,
    validation: CrossValidation,
    *,
    agreement: LensDifference | None,
    left_out: LeftOutPictures,
    flat: LensDifference | None = None,
    uncertainty: LensMap | None = None,
) -> tuple[Gate, ...]:
    """Return the gates on the intrinsics of one camera.

    Parameters
    ----------
    name
        Of the camera; leads the gates' names.
    fit
        The one selected, its covariance enlarged by the dispersion.
    agreement
        Difference to the other backend on the same board, where there is one.
    flat
        Difference to OpenCV on the board as drawn.
    left_out
        Pictures of which the fit rejected most corners.
    uncertainty
        Of the projection, where it is to decide on the coverage.
    """
    gates = [
        _coverage_gate(name, coverage, fit, uncertainty),
        _residual_gate(name, fit, left_out),
        _validation_gate(name, validation),
        _focal_gate(name, fit),
    ]
    if agreement is not None:
        gates.append(
            gate(
                f"{name}-backends",
                agreement.ratio <= AGREEMENT_MAX
                and agreement.rms_px <= AGREEMENT_MAX_PX
                and (flat is None or flat.rms_px <= FLAT_MAX_PX),
                f"{agreement.first} and {agreement.second} differ by {agreement.rms_px:.3f} px rms "
                f"over the covered imager (at most {AGREEMENT_MAX_PX:g}), {agreement.ratio:.2f} of "
                f"their stated uncertainty (at most {AGREEMENT_MAX:g})" + _flat_words(flat),
                remedy="compare the difference map with the coverage and add pictures where it is "
                "large; a board that is not flat needs a stiffer one",
            )
        )
    return tuple(gates)


def _flat_words(flat: LensDifference | None) -> str:
    if flat is None:
        return ""
    return f"; OpenCV on the board as drawn by {flat.rms_px:.3f} px (at most {FLAT_MAX_PX:g})"


def _residual_gate(name: str, fit: LensFit, left_out: LeftOutPictures) -> Gate:
    """Gate on residuals; a few pictures left out whole are told, and count no rejected corners."""
    few = len(left_out.images) <= LEFT_OUT_LIMIT * len(fit.residuals)
    said, remedy = "", "check columns and rows of [board], and that the images are of one camera"
    if left_out.images:
        named = ", ".join(f'"{image}"' for image in left_out.images[:NAMED])
        more = ", ..." if len(left_out.images) > NAMED else ""
        said = f"{len(left_out.images)} of {len(fit.residuals)} pictures left out: {named}{more}"
        remedy = (
            f"look at these pictures first (blurred, turned, of another camera?) and write "
            f"exclude = [{named}{more}] in [cameras.{name}]; if many are left out, {remedy}"
        )
    rejected = max(fit.rejected - left_out.corners, 0) if few else fit.rejected
    return fit_gate(f"{name}-residuals", fit.residuals, rejected, remedy=remedy, left_out=said)


def _coverage_gate(
    name: str, coverage: Coverage, fit: LensFit, uncertainty: LensMap | None
) -> Gate:
    still = _at_one_place(fit.poses[finite(fit.poses)])
    passed, said = coverage.share >= COVERAGE_MIN, ""
    enough = coverage.share >= COVERAGE_LEAST and not still
    if not passed and uncertainty is not None and enough:
        known = uncertainty.std_px[uncertainty.covered]
        relative = float(np.sqrt(np.mean(known**2)) / fit.camera.matrix[0, 0])
        passed = relative <= FIELD_STD_MAX
        said = (
            f"; on them the projection is certain to {100 * relative:.3f} % of the focal length "
            f"(with less than {100 * COVERAGE_MIN:.0f} % at most {100 * FIELD_STD_MAX:g})"
        )
    return gate(
        f"{name}-coverage",
        passed,
        f"corners in {100 * coverage.share:.0f} % of the imager's cells (at least "
        f"{100 * (COVERAGE_LEAST if passed else COVERAGE_MIN):.0f}), out to "
        f"{100 * coverage.reach:.0f} % of its half diagonal{said}"
        + ("; the board stood at one place" if still else ""),
        remedy="add pictures with the board at the edges and corners of the imager",
    )


def _validation_gate(name: str, validation: CrossValidation) -> Gate:
    i = validation.lenses.index(validation.chosen)
    return gate(
        f"{name}-cross-validation",
        bool(validation.ratio[i] <= CROSS_VALIDATION_MAX),
        f"left-out views {validation.rms_px[i]:.3f} px rms, fitted "
        f"{validation.fitted_rms_px[i]:.3f} px; in the median view {validation.ratio[i]:.2f} times "
        f"(at most {CROSS_VALIDATION_MAX:g})",
        remedy="add pictures, or take out those of another camera, focus or board",
    )


def _focal_gate(name: str, fit: LensFit) -> Gate:
    focal = np.diag(fit.camera.matrix)[:2]
    relative = float((np.sqrt(np.diag(fit.covariance)[:2]) / focal).max())
    fault = orientation_fault(fit.poses)
    why = f"; {fault}" if fault else ""
    return gate(
        f"{name}-focal-length",
        relative <= FOCAL_STD_MAX and fault is None,
        f"relative standard uncertainty {100 * relative:.3f} % (at most "
        f"{100 * FOCAL_STD_MAX:g} %){why}",
        remedy="take pictures with the board tilted by 20 to 40 deg in all directions",
    )


def intrinsics_warnings(
    name: str,
    gates: tuple[Gate, ...],
    *,
    dispersion: float,
    splined: LensDifference | None,
    fits_better: bool,
) -> Iterator[str]:
    """Yield what the reader should know of the fit and no gate covers.

    Where `gates` say that the views do not determine the lens, a comparison of lenses says nothing.

    Parameters
    ----------
    splined
        Difference to a splined lens.
    fits_better
        Whether that one fits the corners better than the selected fit. If not, it is the spline
        that lacks shape: ten knots across 150 degrees miss corners found to 0.03 px.
    """
    if dispersion > DISPERSION_WARN:
        yield (
            f"{name}: the views contradict each other {dispersion:.1f} times as much as "
            "independent corner noise explains (board not flat, detector bias, blur); the "
            "covariance of the intrinsics is enlarged by that factor"
        )
    if splined is None or not all(gate.passed for gate in gates):
        return
    if fits_better and splined.ratio > SPLINE_WARN:
        yield (
            f"{name}: {splined.second} differs from {splined.first} by {splined.rms_px:.2f} px rms "
            f"over the covered imager, {splined.ratio:.1f} times their "
            "stated uncertainty: the lens has more shape than its model"
        )
