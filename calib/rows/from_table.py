"""Stage: rows with all their uncertainties, from a table and what the images say of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calib.core.arrays import BoolArray, FloatArray, IntArray
from calib.dataset.contents import Dataset
from calib.dataset.depth_origin import ahead_of_c1
from calib.dataset.manifest import ValidationSection
from calib.dataset.tables import GazeTable
from calib.geometry.camera import (
    Camera,
    normalise_jacobian,
    on_centre_row,
    project,
)
from calib.geometry.parameters import INDEX, PARAMETERS, REFERENCE_OFFSET
from calib.geometry.plane import OBSERVABLE
from calib.rows.common_errors import CommonErrors
from calib.rows.observations import Observations, depth_groups
from calib.rows.rayless import refuse_rayless

U_PITCH_RAD = float(np.deg2rad(1.0))
"""C2 looks level within this, as its tilts and roll by their priors; no row tells its pitch."""

U_PIXEL = 0.1
"""Standard uncertainty of a pixel coordinate that a table gives, px, where nothing better is known.

A corner or a blob's centre by any subpixel method, on a picture in focus.
"""


@dataclass(frozen=True)
class ImageObservations:
    """What images say of the rows of a table; NaN where a row has no image for it.

    Parameters
    ----------
    pixel_c1, pixel_c2
        The target in C1, and in C2 at the reading, px, shape (n, 2).
    u_c1_px, u_c2_px
        Standard uncertainty of a pixel coordinate of each camera, px.
    z_mm, u_z_mm
        Reference depth by stereo and the part of its uncertainty that is the row's own, (n,).
    z_by_common
        Derivative of the reference depth by the shared standard-normal errors, shape (n, k).
    """

    pixel_c1: FloatArray
    pixel_c2: FloatArray
    u_c1_px: float
    u_c2_px: float
    z_mm: FloatArray
    u_z_mm: FloatArray
    z_by_common: FloatArray


@dataclass(frozen=True)
class RowSettings:
    """What the manifest says of the rows' uncertainties, and from where their z_mm counts.

    Parameters
    ----------
    z_ahead_mm
        z_mm counts from so far in front of C1's optical centre.
    u_origin_mm
        Uncertainty of that, where no parameter stands for it.
    """

    u_x1c: float
    u_z_mm: float
    u_z_rel: float
    encoder_step_rad: float
    u_alpha2_rad: float
    u_z_group_mm: float = 0.0
    u_z_group_rel: float = 0.0
    z_ahead_mm: float = 0.0
    u_origin_mm: float = 0.0


def row_settings(dataset: Dataset) -> RowSettings:
    """Return the settings of the gaze rows of a dataset that has some."""
    gaze, encoder = dataset.manifest.gaze, dataset.manifest.encoder
    if gaze is None or encoder is None:
        raise ValueError("a dataset without gaze rows or encoder has no row settings")
    return RowSettings(
        u_x1c=gaze.u_x1c,
        u_z_mm=gaze.u_z_mm,
        u_z_rel=gaze.u_z_rel,
        encoder_step_rad=float(np.deg2rad(encoder.resolution_deg)),
        u_alpha2_rad=float(np.deg2rad(encoder.further_u_deg)),
        u_z_group_mm=gaze.u_z_group_mm,
        u_z_group_rel=gaze.u_z_group_rel,
        z_ahead_mm=ahead_of_c1(gaze.origin)[0],
    )


def row_priors(dataset: Dataset) -> dict[str, tuple[float, float]]:
    """Return the priors of the manifest and that of where its calibration rows' z_mm counts from.

    Mean and standard deviation by parameter. Depths by image pairs count from C1's optical centre
    by themselves; of z_mm it must be said, else the offset is a parameter with its default prior.
    """
    priors = {name: (prior.mean, prior.std) for name, prior in dataset.manifest.priors.items()}
    stated, table = dataset.manifest.gaze, dataset.gaze
    if stated is None or table is None or np.isnan(table.z_mm).all():
        return priors
    if stated.origin is not None:
        u = ahead_of_c1(stated.origin)[1]
        return priors | ({REFERENCE_OFFSET: (0.0, u)} if u > 0 else {})
    default = PARAMETERS[INDEX[REFERENCE_OFFSET]].prior_std or 0.0
    return {REFERENCE_OFFSET: (0.0, default)} | priors


def validation_settings(dataset: Dataset) -> RowSettings:
    """Return the settings of the validation rows: their own reference, the gaze rows' rest."""
    settings, stated = row_settings(dataset), dataset.manifest.validation
    if stated is None:
        return settings
    return replace(
        settings,
        u_z_mm=stated.u_z_mm,
        u_z_rel=stated.u_z_rel,
        u_z_group_mm=stated.u_z_group_mm,
        u_z_group_rel=stated.u_z_group_rel,
        **_validation_origin(stated, settings),
    )


def _validation_origin(stated: ValidationSection, settings: RowSettings) -> dict[str, float]:
    """Return from where validation depths count: as the calibration rows' unless stated."""
    if stated.origin is None:
        return {"z_ahead_mm": settings.z_ahead_mm}
    ahead, u = ahead_of_c1(stated.origin)
    return {"z_ahead_mm": ahead, "u_origin_mm": u}


@dataclass(frozen=True)
class CameraSet:
    """The cameras as far as the rows need them."""

    c1: Camera | None = None
    c2: Camera | None = None


@dataclass(frozen=True)
class Setup:
    """What holds for all rows: settings, cameras and the errors that the rows share."""

    settings: RowSettings
    cameras: CameraSet = field(default_factory=CameraSet)
    shared: CommonErrors = field(default_factory=CommonErrors)


@dataclass(frozen=True)
class ValidationRows:
    """Rows that were never used to fit, with their references.

    Parameters
    ----------
    rows
        The rows; `z_mm` is the first reference.
    depth_of
        For each row the place of the row whose measured depth it uses, shape (n,).
    references
        Further reference depths by name, mm, shape (n,); NaN where a row has none.
    same_origin
        Which of them count from where the calibration rows' z_mm does, shape (n,), so that a
        calibration that finds that place knows more of them; shape (0,) if none.
    """

    rows: Observations
    depth_of: IntArray
    references: Mapping[str, FloatArray]
    same_origin: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def depth_from_c1(self, theta: FloatArray) -> FloatArray:
        """Return first references from C1's optical centre, mm, shape (n,), as `theta` has them."""
        if not len(self.same_origin):
            return self.rows.z_mm
        offset = theta[INDEX[REFERENCE_OFFSET]]
        return np.where(self.same_origin, self.rows.z_mm + offset, self.rows.z_mm)


def observe(
    table: GazeTable, setup: Setup, image_observations: ImageObservations | None
) -> Observations:
    """Return the rows of a table with their covariance.

    Raises
    ------
    InputError
        If a pixel of the table lies where the lens model has no ray.
    """
    settings, shared = setup.settings, setup.shared
    seen = (
        _no_image_observations(len(table), shared.factor.shape[1])
        if image_observations is None
        else image_observations
    )
    source = _Source(table, settings, setup.cameras, shared, seen)
    ray, residual, depth = source.direction(), source.gaze_residual(), source.depth()
    # A motor rests on whole counts. Where C2's image tells how far the target then is from the
    # centre column, that is measured and no longer an error.
    step = np.where(residual.std > 0, 0.0, settings.encoder_step_rad / np.sqrt(12))
    std = np.zeros((len(table), len(OBSERVABLE)))
    std[:, : OBSERVABLE.alpha2] = ray.std
    std[:, OBSERVABLE.alpha2] = np.hypot(step, settings.u_alpha2_rad)
    std[:, OBSERVABLE.residual] = residual.std
    std[:, OBSERVABLE.z] = depth.std
    by_common = np.zeros((len(table), len(OBSERVABLE), shared.factor.shape[1]))
    by_common[:, : OBSERVABLE.alpha2] = ray.by_common
    by_common[:, OBSERVABLE.residual] = residual.by_common
    by_common[:, OBSERVABLE.z] = depth.by_common
    x, y = ray.value.T
    z_group, u_z_group = source.groups()
    return Observations(
        ids=table.ids,
        groups=table.groups,
        x1c=x,
        y1c=np.where(np.isfinite(y), y, 0.0),
        alpha2_rad=np.array(table.alpha2_rad),
        gaze_residual_rad=residual.value,
        z_mm=depth.value,
        std=std,
        has_height=bool(np.isfinite(y).all()),
        shared=by_common if shared.names else np.zeros((0, 0, 0)),
        shared_names=shared.error_names,
        z_group=z_group,
        u_z_group_mm=u_z_group,
    )


def observe_validation(
    table: GazeTable,
    setup: Setup,
    image_observations: ImageObservations | None,
    *,
    own_origin: bool = False,
) -> ValidationRows:
    """Return validation rows: as `observe`, with whose depth each uses and further references.

    Parameters
    ----------
    own_origin
        Whether the manifest says from where their z_mm counts.
    """
    place = {name: i for i, name in enumerate(table.ids)}
    depth_of = [i if d is None else place[d] for i, d in enumerate(table.depth_row)]
    return ValidationRows(
        rows=observe(table, setup, image_observations),
        depth_of=np.array(depth_of, dtype=np.int64),
        references=dict(table.references),
        same_origin=np.zeros(0, dtype=np.bool_) if own_origin else np.isfinite(table.z_mm),
    )


def _no_image_observations(n: int, k: int) -> ImageObservations:
    nothing, nowhere = np.full(n, np.nan), np.full((n, 2), np.nan)
    return ImageObservations(
        pixel_c1=nowhere,
        pixel_c2=nowhere,
        u_c1_px=U_PIXEL,
        u_c2_px=U_PIXEL,
        z_mm=nothing,
        u_z_mm=nothing,
        z_by_common=np.zeros((n, k)),
    )


@dataclass(frozen=True)
class _Part:
    """Some quantities of all rows: value and std of shape (n, ...), by_common (n, ..., k)."""

    value: FloatArray
    std: FloatArray
    by_common: FloatArray


@dataclass(frozen=True)
class _Source:
    """All that is known of the rows of a table."""

    table: GazeTable
    settings: RowSettings
    cameras: CameraSet
    shared: CommonErrors
    seen: ImageObservations

    def _zeros(self, *shape: int) -> FloatArray:
        return np.zeros((len(self.table), *shape))

    def direction(self) -> _Part:
        """Return x1c and y1c, shape (n, 2)."""
        table, camera = self.table, self.cameras.c1
        value = np.stack([table.x1c, table.y1c], axis=1)
        std = self._zeros(2) + self.settings.u_x1c
        if camera is None:
            return _Part(value, std, self._zeros(2, self.shared.factor.shape[1]))
        from_image = np.isfinite(self.seen.pixel_c1[:, 0])
        pixels = np.stack([table.u1_px, table.v1_px], axis=1)
        pixels = np.where(from_image[:, None], self.seen.pixel_c1, pixels)
        rows = np.flatnonzero(np.isfinite(pixels).all(axis=1))
        if len(rows):
            refuse_rayless(table, camera, pixels)
            ray = normalise_jacobian(camera, pixels[rows])
            value[rows] = ray.xy
            u = np.where(from_image, self.seen.u_c1_px, U_PIXEL)[rows]
            std[rows] = u[:, None] * np.sqrt((ray.by_pixel**2).sum(axis=2))
        return _Part(value, std, direction_by_common(value, camera, self.shared))

    def gaze_residual(self) -> _Part:
        """Return the angle from C2's centre column to the target, rad; 0 where not measured."""
        camera = self.cameras.c2
        value, std = self._zeros(), self._zeros()
        by_common = self._zeros(self.shared.factor.shape[1])
        from_image = np.isfinite(self.seen.pixel_c2[:, 0])
        if camera is None:
            return _Part(value, std, by_common)
        pixels = on_centre_row(camera, self.table.u2_px)
        pixels = np.where(from_image[:, None], self.seen.pixel_c2, pixels)
        rows = np.flatnonzero(np.isfinite(pixels[:, 0]))
        if len(rows):
            refuse_rayless(self.table, camera, pixels)
            ray = normalise_jacobian(camera, pixels[rows])
            slope = 1 / (1 + ray.xy[:, 0] ** 2)
            u = np.where(from_image, self.seen.u_c2_px, U_PIXEL)[rows]
            value[rows] = np.arctan(ray.xy[:, 0])
            own = u * slope * np.sqrt((ray.by_pixel[:, 0] ** 2).sum(axis=1))
            std[rows] = np.hypot(own, self._by_pitch(value)[rows])
            by_intrinsics = slope[:, None] * ray.by_intrinsics[:, 0]
            by_common[rows] = by_intrinsics @ self.shared.of_camera("c2", camera)
        return _Part(value, std, by_common)

    def _by_pitch(self, residual: FloatArray) -> FloatArray:
        """Return what an unknown pitch of C2 makes uncertain of gaze residuals, rad, shape (n,).

        It turns the residual by the target's height in C2's image, which is about that in C1's.
        """
        height = np.nan_to_num(self.direction().value[:, 1])
        u: FloatArray = U_PITCH_RAD * np.abs(residual * height)
        return u

    def depth(self) -> _Part:
        """Return the reference depths, mm."""
        table, settings, seen = self.table, self.settings, self.seen
        known = np.isfinite(table.z_mm)
        z = np.where(known, table.z_mm + settings.z_ahead_mm, seen.z_mm)
        default = np.hypot(settings.u_z_mm, settings.u_z_rel * z)
        stated = np.where(np.isfinite(table.u_z_mm), table.u_z_mm, default)
        stated = np.hypot(stated, settings.u_origin_mm)
        std = np.where(known, np.hypot(stated, self._u_group(z)), seen.u_z_mm)
        return _Part(z, std, np.where(known[:, None], 0.0, seen.z_by_common))

    def _u_group(self, z: FloatArray) -> FloatArray:
        """Return what is uncertain of stated depths together with their group's, mm, shape (n,)."""
        u: FloatArray = np.hypot(self.settings.u_z_group_mm, self.settings.u_z_group_rel * z)
        return u

    def groups(self) -> tuple[IntArray, FloatArray]:
        """Return which rows have one reference measurement, and its error, mm; shape (n,) each.

        Stated depths are grouped by `group`, those of image pairs by pair: all that is uncertain
        of a pair's depth is one error of the rows that take it from there. Depths by the board in
        a row's own picture stand alone.
        """
        stated = np.isfinite(self.table.z_mm)
        u = np.where(stated, self._u_group(self.table.z_mm), self.seen.u_z_mm)
        if not np.nan_to_num(u).any():
            return depth_groups((), u)
        table = self.table
        names = zip(stated.tolist(), table.groups, table.stereo, table.ids, strict=True)
        return depth_groups(
            [
                ("group", g) if given else ("pair", s) if s else ("board", row)
                for given, g, s, row in names
            ],
            u,
        )


def direction_by_common(xy: FloatArray, camera: Camera, shared: CommonErrors) -> FloatArray:
    """Return what the shared errors of C1's intrinsics do to directions, shape (n, 2, k).

    Parameters
    ----------
    xy
        Normalised coordinates, shape (n, 2); where y is NaN it is taken as 0.
    """
    factor = shared.of_camera("c1", camera)
    by_common = np.zeros((len(xy), 2, factor.shape[1]))
    if not np.any(factor):
        return by_common
    ray = normalise_jacobian(camera, project(camera, np.nan_to_num(xy)))
    by_common[:] = ray.by_intrinsics @ factor
    return by_common
