"""Stage: rows with all their uncertainties, from a table and what the images say of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.dataset.contents import Dataset
from calib.dataset.tables import GazeTable
from calib.errors import EstimationError, InputError, Problem
from calib.geometry.camera import Camera, normalise, normalise_jacobian
from calib.geometry.plane import OBSERVABLE
from calib.observations import Observations

U_PIXEL = 0.1
"""Standard uncertainty of a pixel coordinate that a table gives, px, where nothing better is known.

A corner or a blob's centre by any subpixel method, on a picture in focus.
"""


@dataclass(frozen=True)
class Shared:
    """What all rows have wrong together: once-estimated intrinsics and stereo extrinsics.

    Parameters
    ----------
    names
        Of the estimated quantities, e.g. ``c1 fx``; q of them.
    covariance
        Shape (q, q), units of the quantities.
    """

    names: tuple[str, ...] = ()
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def factor(self) -> FloatArray:
        """Return F, shape (q, k), with F F^T the covariance: k standard-normal errors."""
        if not self.names:
            return np.zeros((0, 0))
        unit = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        value, vector = np.linalg.eigh(self.covariance / np.outer(unit, unit))
        keep = value > 1e-12 * max(value[-1], 1e-300)
        factor: FloatArray = unit[:, None] * vector[:, keep] * np.sqrt(value[keep])
        return factor

    def place(self, prefix: str) -> IntArray:
        """Return the places of the quantities whose names start with `prefix`."""
        return np.array([i for i, n in enumerate(self.names) if n.startswith(prefix)], dtype=int)


@dataclass(frozen=True)
class Sightings:
    """What images say of the rows of a table; NaN where a row has no image for it.

    Parameters
    ----------
    pixel_c1
        The target in C1, px, shape (n, 2).
    u_pixel
        Standard uncertainty of a pixel coordinate, px.
    u2_px, v2_px
        The target in C2 at the reading, px, shape (n,).
    z_mm, u_z_mm
        Reference depth by stereo and the part of its uncertainty that is the row's own, (n,).
    z_by_shared
        Derivative of the reference depth by the shared quantities, shape (n, q).
    """

    pixel_c1: FloatArray
    u_pixel: float
    u2_px: FloatArray
    v2_px: FloatArray
    z_mm: FloatArray
    u_z_mm: FloatArray
    z_by_shared: FloatArray


@dataclass(frozen=True)
class RowSettings:
    """What the manifest says of the rows' uncertainties."""

    u_x1c: float
    u_z_mm: float
    u_z_rel: float
    encoder_step_rad: float
    u_alpha2_rad: float


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
        u_alpha2_rad=float(np.deg2rad(encoder.u_alpha2_deg)),
    )


def validation_settings(dataset: Dataset) -> RowSettings:
    """Return the settings of the validation rows: their own reference, the gaze rows' rest."""
    settings, stated = row_settings(dataset), dataset.manifest.validation
    if stated is None:
        return settings
    return replace(settings, u_z_mm=stated.u_z_mm, u_z_rel=stated.u_z_rel)


@dataclass(frozen=True)
class CameraSet:
    """The cameras as far as the rows need them."""

    c1: Camera | None = None
    c2: Camera | None = None


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
    """

    rows: Observations
    depth_of: IntArray
    references: Mapping[str, FloatArray]


def observe(
    table: GazeTable,
    settings: RowSettings,
    cameras: CameraSet,
    shared: Shared,
    sightings: Sightings | None,
) -> Observations:
    """Return the rows of a table with their covariance.

    Raises
    ------
    InputError
        If a pixel of the table lies where the lens model has no ray.
    """
    seen = _no_sightings(len(table), len(shared.names)) if sightings is None else sightings
    source = _Source(table, settings, cameras, shared, seen)
    ray, residual, depth = source.direction(), source.gaze_residual(), source.depth()
    # A motor rests on whole counts. Where C2's image tells how far the target then is from the
    # centre column, that is measured and no longer an error.
    step = np.where(residual.std > 0, 0.0, settings.encoder_step_rad / np.sqrt(12))
    std = np.zeros((len(table), len(OBSERVABLE)))
    std[:, : OBSERVABLE.alpha2] = ray.std
    std[:, OBSERVABLE.alpha2] = np.hypot(step, settings.u_alpha2_rad)
    std[:, OBSERVABLE.residual] = residual.std
    std[:, OBSERVABLE.z] = depth.std
    by_shared = np.zeros((len(table), len(OBSERVABLE), len(shared.names)))
    by_shared[:, : OBSERVABLE.alpha2] = ray.by_shared
    by_shared[:, OBSERVABLE.residual] = residual.by_shared
    by_shared[:, OBSERVABLE.z] = depth.by_shared
    factor = shared.factor()
    x, y = ray.value.T
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
        shared=by_shared @ factor if factor.size else np.zeros((0, 0, 0)),
        shared_names=tuple(f"shared {i + 1}" for i in range(factor.shape[1])),
    )


def observe_validation(
    table: GazeTable,
    settings: RowSettings,
    cameras: CameraSet,
    shared: Shared,
    sightings: Sightings | None,
) -> ValidationRows:
    """Return validation rows: as `observe`, with whose depth each uses and further references."""
    place = {name: i for i, name in enumerate(table.ids)}
    depth_of = [i if d is None else place[d] for i, d in enumerate(table.depth_row)]
    return ValidationRows(
        rows=observe(table, settings, cameras, shared, sightings),
        depth_of=np.array(depth_of, dtype=np.int64),
        references=dict(table.references),
    )


def _no_sightings(n: int, q: int) -> Sightings:
    nothing = np.full(n, np.nan)
    return Sightings(
        pixel_c1=np.full((n, 2), np.nan),
        u_pixel=U_PIXEL,
        u2_px=nothing,
        v2_px=nothing,
        z_mm=nothing,
        u_z_mm=nothing,
        z_by_shared=np.zeros((n, q)),
    )


@dataclass(frozen=True)
class _Part:
    """Some quantities of all rows: value and std of shape (n, ...), by_shared (n, ..., q)."""

    value: FloatArray
    std: FloatArray
    by_shared: FloatArray


@dataclass(frozen=True)
class _Source:
    """All that is known of the rows of a table."""

    table: GazeTable
    settings: RowSettings
    cameras: CameraSet
    shared: Shared
    seen: Sightings

    def _zeros(self, *shape: int) -> FloatArray:
        return np.zeros((len(self.table), *shape))

    def direction(self) -> _Part:
        """Return x1c and y1c, shape (n, 2)."""
        table, camera = self.table, self.cameras.c1
        value = np.stack([table.x1c, table.y1c], axis=1)
        std = self._zeros(2) + self.settings.u_x1c
        by_shared = self._zeros(2, len(self.shared.names))
        from_image = np.isfinite(self.seen.pixel_c1[:, 0])
        pixels = np.stack([table.u1_px, table.v1_px], axis=1)
        pixels = np.where(from_image[:, None], self.seen.pixel_c1, pixels)
        rows = np.flatnonzero(np.isfinite(pixels).all(axis=1))
        if camera is None or not len(rows):
            return _Part(value, std, by_shared)
        _refuse_folded(table, camera, pixels)
        ray = normalise_jacobian(camera, pixels[rows])
        value[rows] = ray.xy
        u = np.where(from_image, self.seen.u_pixel, U_PIXEL)[rows]
        std[rows] = u[:, None] * np.sqrt((ray.by_pixel**2).sum(axis=2))
        place = self.shared.place("c1 ")
        if len(place):
            by_shared[rows[:, None], :, place] = ray.by_intrinsics.transpose(0, 2, 1)
        return _Part(value, std, by_shared)

    def gaze_residual(self) -> _Part:
        """Return the angle from C2's centre column to the target, rad; 0 where not measured."""
        camera = self.cameras.c2
        value, std = self._zeros(), self._zeros()
        by_shared = self._zeros(len(self.shared.names))
        from_image = np.isfinite(self.seen.u2_px)
        u2 = np.where(from_image, self.seen.u2_px, self.table.u2_px)
        rows = np.flatnonzero(np.isfinite(u2))
        if camera is None or not len(rows):
            return _Part(value, std, by_shared)
        # A table gives the column alone; near the centre column the row hardly matters.
        v2 = np.where(from_image, self.seen.v2_px, camera.matrix[1, 2])
        ray = normalise_jacobian(camera, np.stack([u2, v2], axis=1)[rows])
        slope = 1 / (1 + ray.xy[:, 0] ** 2)
        u = np.where(from_image, self.seen.u_pixel, U_PIXEL)[rows]
        value[rows] = np.arctan(ray.xy[:, 0])
        std[rows] = u * slope * np.sqrt((ray.by_pixel[:, 0] ** 2).sum(axis=1))
        place = self.shared.place("c2 ")
        if len(place):
            by_shared[rows[:, None], place] = slope[:, None] * ray.by_intrinsics[:, 0]
        return _Part(value, std, by_shared)

    def depth(self) -> _Part:
        """Return the reference depths, mm."""
        table, settings, seen = self.table, self.settings, self.seen
        known = np.isfinite(table.z_mm)
        z = np.where(known, table.z_mm, seen.z_mm)
        default = np.hypot(settings.u_z_mm, settings.u_z_rel * z)
        stated = np.where(np.isfinite(table.u_z_mm), table.u_z_mm, default)
        std = np.where(known, stated, seen.u_z_mm)
        return _Part(z, std, np.where(known[:, None], 0.0, seen.z_by_shared))


def _refuse_folded(table: GazeTable, camera: Camera, pixels: FloatArray) -> None:
    """Raise an InputError that names the rows whose pixel no ray of the lens reaches."""
    try:
        normalise(camera, pixels)
        return
    except EstimationError:
        pass
    problems = []
    for i, pixel in enumerate(pixels):
        try:
            normalise(camera, pixel[None])
        except EstimationError as error:
            where = f"{table.file}, line {table.line[i]} (id {table.ids[i]})"
            remedy = "check the pixel against image_size and the camera's intrinsics"
            problems.append(Problem(where, str(error), remedy))
    raise InputError(problems)
