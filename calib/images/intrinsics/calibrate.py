"""Stage: the intrinsics of one camera by both backends, and the one to use."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from calib.core.arrays import FloatArray, IntArray
from calib.core.errors import EstimationError, InputError
from calib.core.gate import Gate
from calib.geometry.board import Board, Corners, LensFit
from calib.geometry.camera import Camera
from calib.images.bundle import deformed
from calib.images.detection.grid import seen
from calib.images.intrinsics.backends import Backends, solve_backends, views_of
from calib.images.intrinsics.covariance import view_scores
from calib.images.intrinsics.flips import flipped_pictures, way_gate
from calib.images.intrinsics.gates import (
    intrinsics_gates,
    intrinsics_warnings,
    orientation_fault,
    views_left_out,
)
from calib.images.intrinsics.maps import (
    Coverage,
    LensDifference,
    LensMap,
    LensRays,
    Nodes,
    compare,
    map_uncertainty,
    measure_coverage,
    nodes,
    rays_of,
)
from calib.images.intrinsics.remarks import (
    backend_warnings,
    better,
    fit_warnings,
    other_fits_better,
    picture_warnings,
)
from calib.images.intrinsics.validate import CrossValidation, cross_validate
from calib.images.mrcal.solves import MIN_CORNERS, focal_start
from calib.images.opencv import steady_opencv
from calib.images.pairs import single_view_pose
from calib.images.repeats import repeat_clusters, repeats_warning

MIN_VIEWS = 6
"""Views needed: three leave nine or more intrinsics without a check, and cross-validation wants to
leave some out."""

ON_SOLVED_BOARD = MappingProxyType(
    {"mrcal": " on mrcal's board", "joint": " on the board as solved here"}
)
"""Added to the lens model of OpenCV's fits to the board as another backend solved it."""


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics of one camera.

    Parameters
    ----------
    name
        Of the camera, as in the manifest.
    selected
        The fit to use.
    covariance
        Of its fx, fy, cx, cy and distortion, px and 1, shape (4 + k, 4 + k): enlarged by
        `dispersion`, as that of each fit is by its own, and by errors of the board's corners.
    dispersion
        Variance of the estimate as the views show it over that which independent corner noise
        explains; below 1 as far as they prove it.
    alternatives
        The other fits: both backends, all lens models.
    selection
        The rule's reasons.
    images
        One a view.
    rejected_views
        Images in which a board was found that the selected fit does not use.
    detectors
        Views by detector.
    coverage, uncertainty
        Maps over the imager.
    differences
        To other lens models and the other backend.
    validation
        Leave-views-out cross-validation.
    model_files
        Text of mrcal's ``.cameramodel`` of its fits by lens model, with the solve's inputs.
    mrcal_version
        None without mrcal.
    gates, warnings
        What must hold, and what else the reader should know.
    purposes
        Images by what they were taken for ("lens", "pair", "row") where a joint solve refined the
        estimate; empty where the camera's own pictures gave it.
    """

    name: str
    selected: LensFit
    covariance: FloatArray
    dispersion: float
    alternatives: tuple[LensFit, ...]
    selection: str
    images: tuple[str, ...]
    rejected_views: tuple[str, ...]
    detectors: Mapping[str, int]
    coverage: Coverage
    uncertainty: LensMap
    differences: tuple[LensDifference, ...]
    validation: CrossValidation
    model_files: Mapping[str, str]
    mrcal_version: str | None
    gates: tuple[Gate, ...]
    warnings: tuple[str, ...]
    purposes: Mapping[str, int]

    @property
    def camera(self) -> Camera:
        """The camera to use."""
        return self.selected.camera


def calibrate_intrinsics(corners: Corners, board: Board, *, camera: str, seed: int) -> Intrinsics:
    """Return the intrinsics of one camera from views of a board.

    The rule: the lens model is the simplest unless a larger one predicts left-out views better
    beyond doubt (`select_lens`); of its two fits mrcal's is used where there is one, as it solves
    the deformation of the board too, and OpenCV's otherwise.

    Parameters
    ----------
    camera
        Name of the camera, for messages and gates.
    seed
        Of mrcal's random numbers.

    Raises
    ------
    InputError
        If fewer than `MIN_VIEWS` different views show the board.
    EstimationError
        If no backend finds a solution.
    """
    corners, repeated = _distinct(corners)
    _require_views(corners, board, camera)
    try:
        with steady_opencv():
            backends = solve_backends(corners, board, seed)
            validation = cross_validate(corners, board, backends.tested, points=backends.points)
            return _assemble(
                corners, backends, validation, camera=camera, repeated=repeated, board=board
            )
    except EstimationError as error:
        raise EstimationError(_diagnosis(corners, board, camera, error)) from error


def _distinct(corners: Corners) -> tuple[Corners, tuple[str, ...]]:
    """Blank out views that repeat an earlier one corner for corner; return their images too."""
    first: dict[bytes, int] = {}
    repeated = []
    for i, view in enumerate(corners.pixels):
        if seen(view).any() and first.setdefault(view.tobytes(), i) != i:
            repeated.append(i)
    pixels = corners.pixels.copy()
    pixels[repeated] = np.nan
    return replace(corners, pixels=pixels), tuple(corners.images[i] for i in repeated)


def _require_views(corners: Corners, board: Board, camera: str) -> None:
    kind = "columns and rows"
    if board.type == "charuco":
        kind = "columns, rows, dictionary and legacy"
    usable = int((seen(corners.pixels).sum(axis=-1) >= MIN_CORNERS).sum())
    if usable < MIN_VIEWS:
        raise InputError.single(
            where=f"dataset.toml, [cameras.{camera}], images",
            what=f"the board is found, with {MIN_CORNERS} corners or more, in {usable} different "
            f"views of {len(corners.images)}, and {MIN_VIEWS} are needed",
            remedy=f"add sharp pictures of the whole board, and check {kind} of [board]",
        )


def _diagnosis(corners: Corners, board: Board, camera: str, error: EstimationError) -> str:
    """Say why no solution was found: from poses under the first guess of the focal length."""
    focal = focal_start(corners, board)
    middle = (np.array(corners.image_size) - 1) / 2
    guess = Camera(
        np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]]),
        np.zeros(0),
        corners.image_size,
    )
    views = [view for view in corners.pixels if seen(view).sum() >= MIN_CORNERS]
    points = board.object_points()
    poses = [single_view_pose(guess, points=points, pixels=view)[0] for view in views]
    fault = orientation_fault(np.stack(poses))
    why = f"{fault}: take pictures with other tilts; " if fault else ""
    return f"intrinsics of {camera}: {why}{error}"


def _assemble(
    corners: Corners,
    backends: Backends,
    validation: CrossValidation,
    *,
    camera: str,
    repeated: tuple[str, ...],
    board: Board,
) -> Intrinsics:
    """Select a fit and judge it."""
    drawn = board.object_points()
    lens, mrcal = validation.chosen, backends.mrcal
    selected, worse = better(backends.bowed.get(lens), backends.checked.get(lens))
    points = backends.points[lens]
    clusters = repeat_clusters(corners.pixels, drawn)
    enlarged, dispersion = _enlarged(selected, points, clusters)
    inliers = np.where(np.isfinite(selected.residuals), corners.pixels, np.nan)
    coverage = measure_coverage(inliers, corners.image_size)
    at = nodes(inliers, corners.image_size)
    uncertainty = map_uncertainty(enlarged, at)
    agreement, splined, others = _differences(enlarged, selected, backends, lens, at)
    unused = seen(corners.pixels).any(axis=-1) & ~views_of(selected)
    flipped = flipped_pictures(
        corners,
        board,
        backends.tested[lens],
        points=backends.points[lens],
        factor=dispersion,
    )
    left_out = views_left_out(corners.images, corners.pixels, selected.residuals)
    drawn_fit = backends.flat.get(lens)
    others_better = other_fits_better(selected, [f for f in backends.all if f is not selected])
    flat = (
        compare(enlarged, rays_of(drawn_fit, at), at)
        if drawn_fit is not None and agreement is not None
        else None
    )
    gates = intrinsics_gates(
        camera,
        enlarged,
        coverage,
        validation,
        agreement=agreement,
        flat=flat,
        left_out=left_out,
        uncertainty=uncertainty,
    )
    return Intrinsics(
        name=camera,
        selected=enlarged,
        covariance=enlarged.covariance,
        dispersion=dispersion,
        alternatives=tuple(
            _enlarged(fit, deformed(drawn, fit.board_warp_mm), clusters)[0]
            for fit in backends.all
            if fit is not selected
        ),
        selection=_selection(selected, validation, backends),
        images=corners.images,
        rejected_views=tuple(corners.images[i] for i in np.flatnonzero(unused)),
        detectors=dict(Counter(corners.detector)),
        coverage=coverage,
        uncertainty=uncertainty,
        differences=tuple(d for d in (agreement, splined, *others) if d is not None),
        validation=validation,
        model_files=mrcal.model_files,
        mrcal_version=None if mrcal.missing else mrcal.version,
        gates=(*gates, way_gate(camera, flipped, int(views_of(selected).sum()))),
        warnings=(
            *picture_warnings(camera, corners, repeated, left_out.images),
            *repeats_warning(camera, corners.images, clusters),
            *backend_warnings(camera, mrcal),
            *(f"{camera}: {said}" for said in (worse, *others_better) if said),
            *fit_warnings(camera, selected, corners, board),
            *intrinsics_warnings(
                camera,
                gates,
                dispersion=dispersion,
                splined=splined,
                fits_better=mrcal.splined_rms_px < selected.rms_px,
            ),
        ),
        purposes={},
    )


def _enlarged(fit: LensFit, points: FloatArray, clusters: IntArray) -> tuple[LensFit, float]:
    """Return a fit with the covariance that its views and corners bear out, and the views' factor.

    Parameters
    ----------
    points
        Corners of the board as the fit has it, mm, shape (corners, 3).
    clusters
        Of each view, shape (views,).
    """
    warp = fit.board_warp_mm is not None
    scores = view_scores(fit.camera, fit.poses, fit.residuals, points, warp=warp)
    factor = scores.dispersion(clusters[views_of(fit)])
    covariance = fit.covariance * factor + scores.board_covariance()
    return replace(fit, covariance=covariance), factor


def _differences(
    enlarged: LensFit, selected: LensFit, backends: Backends, lens: str, at: Nodes
) -> tuple[LensDifference | None, LensDifference | None, list[LensDifference]]:
    """Return how the selected fit differs from the other backend's, from a spline, from the rest.

    `enlarged` is the selected one with its final covariance.
    """
    agreement = splined = None
    checked = backends.checked.get(lens)
    if selected.backend != "opencv" and checked is not None:
        shaped = replace(checked, lens_model=checked.lens_model + ON_SOLVED_BOARD[selected.backend])
        agreement = compare(enlarged, rays_of(shaped, at), at)
    spline = backends.mrcal.splined
    if spline is not None:
        splined = compare(enlarged, LensRays("mrcal splined", spline.rays, spline.std_px), at)
    others = [fit for fit in backends.all if fit is not selected]
    return agreement, splined, [compare(enlarged, rays_of(fit, at), at) for fit in others]


def _selection(selected: LensFit, validation: CrossValidation, backends: Backends) -> str:
    """Say which fit was selected and why."""
    mrcal = backends.mrcal
    if selected.backend == "mrcal":
        backend = "mrcal, which solves the deformation of the board too"
    elif selected.backend == "joint":
        backend = "this program's own least squares, which solve the deformation of the board too"
    else:
        backend = "OpenCV, " + ("alone here" if mrcal.missing else "as mrcal found none so good")
    return "; ".join([validation.reason, *backends.failed, f"by {backend}"])
