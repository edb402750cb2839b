"""Gaze rows of a simulated rig: what a lab would write into its tables, with the truth beside it.

How a row comes about: the motor turns C2 until the target is on the centre column, as well as whole
counts allow, so the target stays off the gaze plane by up to half a count (uniformly). C2 stands at
the count but for a small error. If the target's column in C2 is read, that remainder is known as
the gaze residual; if not, it is the row's quantisation error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import BoolArray, FloatArray
from calib.core.errors import UsageError
from calib.geometry.camera import Camera
from calib.geometry.misclosure import misclosure
from calib.geometry.plane import OBSERVABLE, Gaze, OutOfGazeError, gaze_at
from calib.rows.observations import Observations
from calib.simulate.rig import TrueRig, c2_pose

FIELD_USED = 0.95
"""Share of the field of view that targets fall into; a target at the very edge is not measured."""

OUTLIER_ANGLE = (0.005, 0.05)
"""Size of a gross error of x1c or of the reading, rad: 5 to 50 px, a neighbouring corner."""

OUTLIER_DEPTH = (0.03, 0.3)
"""Relative size of a gross error of the reference depth: a slip of the ruler, a mistaken pair."""

_NEWTON_STEPS = 5

_BATCHES = 200
"""Draws before a scene counts as empty: they find a point of which one in a thousand is seen."""


@dataclass(frozen=True)
class SimulatedRows:
    """Rows as observed and as they truly were.

    Parameters
    ----------
    observed
        What the lab has, with the standard uncertainties that the rig's noise implies.
    true_gaze
        True x1c, y1c; alpha2 where C2 stood; the true gaze residual, rad. Each shape (n,).
    points_mm
        Targets, frame C1, mm, shape (n, 3); the true depth is the last column.
    rays_c2
        Normalised coordinates of the targets in C2 where it stood, shape (n, 2).
    outliers
        Rows with a gross error, shape (n,).
    """

    observed: Observations
    true_gaze: Gaze
    points_mm: FloatArray
    rays_c2: FloatArray
    outliers: BoolArray

    @property
    def z_mm(self) -> FloatArray:
        """True depths, mm, shape (n,)."""
        return self.points_mm[:, 2]


def simulate_rows(
    rig: TrueRig,
    rng: np.random.Generator,
    *,
    count: int,
    depth_range_mm: tuple[float, float],
    residual_measured: bool = False,
    outlier_share: float = 0.0,
) -> SimulatedRows:
    """Simulate gaze rows at random targets: `draw_targets`, then `observe`."""
    points = draw_targets(rig, rng, count=count, depth_range_mm=depth_range_mm)
    return observe(
        rig, rng, points, residual_measured=residual_measured, outlier_share=outlier_share
    )


def draw_targets(
    rig: TrueRig, rng: np.random.Generator, *, count: int, depth_range_mm: tuple[float, float]
) -> FloatArray:
    """Draw targets, frame C1, mm, shape (count, 3), that the rig can gaze at.

    Uniform in depth and over C1's image among the points that C2 sees at a yaw within reach.

    Raises
    ------
    UsageError
        If the fields of view and the yaw range leave nearly no such point.
    """
    lower, upper = _field(rig.c1)
    found: list[FloatArray] = []
    have = 0
    for _ in range(_BATCHES):
        batch = 2 * (count - have) + 8
        normalised = rng.uniform(lower, upper, (batch, 2))
        z = rng.uniform(*depth_range_mm, batch)
        points = z[:, None] * np.column_stack([normalised, np.ones(batch)])
        points = points[within_reach(rig, points)][: count - have]
        found.append(points)
        have += len(points)
        if have == count:
            return np.concatenate(found)
    low, high = depth_range_mm
    raise UsageError(
        f"hardly any point between {low:.0f} and {high:.0f} mm is seen by both cameras at a yaw "
        "within reach; ask for larger depths or a shorter baseline"
    )


def no_rig(error: OutOfGazeError) -> UsageError:
    """Return what is said of parameters by which C2 cannot gaze at a target."""
    return UsageError(
        f"the parameters make no rig: {error}; ask for a smaller eccentricity, smaller tilts or a "
        "longer baseline"
    )


def within_reach(rig: TrueRig, points: FloatArray) -> BoolArray:
    """Return which points, frame C1, mm, shape (n, 3), C2 can be turned to and then sees.

    Raises
    ------
    UsageError
        If the yaw axis is among the points.
    """
    try:
        reading = gaze_at(rig.theta, points).alpha2
    except OutOfGazeError as error:
        raise no_rig(error) from error
    height = rays_in_c2(rig, reading, points)[:, 1]
    (_, top), (_, bottom) = _field(rig.c2)
    low, high = rig.yaw_range_rad
    reachable: BoolArray = (reading > low) & (reading < high) & (height > top) & (height < bottom)
    return reachable


def rays_in_c2(rig: TrueRig, reading: FloatArray, points: FloatArray) -> FloatArray:
    """Return normalised coordinates in C2, shape (n, 2), of a point seen at each reading."""
    pose = c2_pose(rig, reading)
    seen = np.einsum("nji,nj->ni", pose[:, :3, :3], points - pose[:, :3, 3])
    rays: FloatArray = seen[:, :2] / seen[:, 2:]
    return rays


def _field(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest normalised x and y of the usable field, each shape (2,).

    That of the camera without its lens distortion: the simulated lenses see a little more.
    """
    focal, centre = np.diag(camera.matrix)[:2], camera.matrix[:2, 2]
    size = np.array(camera.image_size, dtype=float)
    return FIELD_USED * -centre / focal, FIELD_USED * (size - 1 - centre) / focal


def observe(
    rig: TrueRig,
    rng: np.random.Generator,
    points: FloatArray,
    *,
    residual_measured: bool = False,
    outlier_share: float = 0.0,
) -> SimulatedRows:
    """Simulate the gazes at given targets.

    Parameters
    ----------
    points
        Targets, frame C1, mm, shape (n, 3).
    residual_measured
        Whether the target's column is read in C2's image; else the observed residual is 0.
    outlier_share
        Probability of a row to carry a gross error in x1c, in the reading or in the depth.
    """
    count = len(points)
    noise = rig.noise
    aimed = gaze_at(rig.theta, points)
    reading = np.rint(aimed.alpha2 / rig.resolution_rad) * rig.resolution_rad
    stands = reading + noise.encoder_rad * rng.standard_normal(count)
    rays_c2 = rays_in_c2(rig, stands, points)
    still = np.zeros(count)
    true_gaze = _seen_from(rig, replace(aimed, alpha2=stands), points[:, 2])

    std = row_std(rig, points[:, 2], residual_measured=residual_measured)
    shared, names = _shared_loadings(rig, points)
    own = std * rng.standard_normal(std.shape)
    common = shared @ rng.standard_normal(len(names)) if names else np.zeros_like(std)
    observed = own + common + np.column_stack([aimed.x1c, aimed.y1c, reading, still, points[:, 2]])
    # Of the reading, the rounding and the standing error are in it already.
    observed[:, OBSERVABLE.alpha2] = reading
    if residual_measured:
        observed[:, OBSERVABLE.residual] += np.arctan(rays_c2[:, 0])
    outliers = _spoil(rig, rng, observed, share=outlier_share)
    return SimulatedRows(
        observed=_observations(observed, std, shared, names),
        true_gaze=true_gaze,
        points_mm=points,
        rays_c2=rays_c2,
        outliers=outliers,
    )


def _seen_from(rig: TrueRig, gaze: Gaze, z_mm: FloatArray) -> Gaze:
    """Return gazes with the residuals, at C2's centre, with which the model gives depths `z_mm`.

    By Newton's method: an angle of some degrees at most, nearly linear in the misclosure.
    """
    for _ in range(_NEWTON_STEPS):
        c = misclosure(rig.theta, gaze, z_mm, parameters=())
        slope = c.by_observable[:, OBSERVABLE.residual]
        gaze = replace(gaze, residual=gaze.residual - c.value / slope)
    return gaze


def row_std(rig: TrueRig, z_mm: FloatArray, *, residual_measured: bool) -> FloatArray:
    """Return the standard uncertainties of rows at depths `z_mm`, shape (n, 5) as `OBSERVABLE`.

    The reading's is that of a uniform error of one count, eq. step / sqrt(12) (GUM 4.3.7), unless
    the gaze residual is measured, which leaves only the motor's standing error.
    """
    noise = rig.noise
    rounding = 0.0 if residual_measured else rig.resolution_rad / np.sqrt(12)
    std = np.zeros((len(z_mm), len(OBSERVABLE)))
    std[:, OBSERVABLE.x1c] = noise.pixel_px / rig.c1.matrix[0, 0]
    std[:, OBSERVABLE.y1c] = noise.pixel_px / rig.c1.matrix[1, 1]
    std[:, OBSERVABLE.alpha2] = np.hypot(rounding, noise.encoder_rad)
    if residual_measured:
        std[:, OBSERVABLE.residual] = noise.pixel_px / rig.c2.matrix[0, 0]
    std[:, OBSERVABLE.z] = np.hypot(noise.z_mm, noise.z_rel * z_mm)
    return std


def _shared_loadings(rig: TrueRig, points: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Return loadings, shape (n, 5, k), and names of the errors common to all rows."""
    noise = rig.noise
    x, y, z = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2], points[:, 2]
    loads = {
        "C1 focal length": (noise.shared_focal, {OBSERVABLE.x1c: x, OBSERVABLE.y1c: y}),
        "C1 principal point, u": (noise.shared_centre, {OBSERVABLE.x1c: np.ones_like(x)}),
        "C1 principal point, v": (noise.shared_centre, {OBSERVABLE.y1c: np.ones_like(y)}),
        "scale of the reference depth": (noise.shared_z_rel, {OBSERVABLE.z: z}),
    }
    present = tuple(name for name, (size, _) in loads.items() if size > 0)
    if not present:
        return np.zeros((0, 0, 0)), ()
    shared = np.zeros((len(points), len(OBSERVABLE), len(present)))
    for k, name in enumerate(present):
        size, columns = loads[name]
        for column, load in columns.items():
            shared[:, column, k] = size * load
    return shared, present


def _spoil(
    rig: TrueRig, rng: np.random.Generator, observed: FloatArray, *, share: float
) -> BoolArray:
    """Put gross errors into rows of `observed`, shape (n, 5), in place; return which."""
    count = len(observed)
    # Drawn last and whatever the share is: a seed's rows differ in their outliers only.
    hit = rng.random(count) < share
    column = rng.choice([OBSERVABLE.x1c, OBSERVABLE.alpha2, OBSERVABLE.z], count)
    sign = rng.choice([-1.0, 1.0], count)
    place = rng.random(count)
    angle = sign * _between(OUTLIER_ANGLE, place)
    factor = np.exp(sign * _between(OUTLIER_DEPTH, place))
    whole = np.rint(angle / rig.resolution_rad) * rig.resolution_rad
    observed[:, OBSERVABLE.x1c] += np.where(hit & (column == OBSERVABLE.x1c), angle, 0)
    observed[:, OBSERVABLE.alpha2] += np.where(hit & (column == OBSERVABLE.alpha2), whole, 0)
    observed[:, OBSERVABLE.z] *= np.where(hit & (column == OBSERVABLE.z), factor, 1)
    return hit


def _between(limits: tuple[float, float], place: FloatArray) -> FloatArray:
    """Return values at places 0 to 1, shape (n,), between the limits, evenly in the logarithm."""
    low, high = limits
    value: FloatArray = low * (high / low) ** place
    return value


def _observations(
    observed: FloatArray, std: FloatArray, shared: FloatArray, names: tuple[str, ...]
) -> Observations:
    ids = tuple(f"t{i:03d}" for i in range(1, len(observed) + 1))
    return Observations(
        ids=ids,
        groups=ids,
        x1c=observed[:, OBSERVABLE.x1c],
        y1c=observed[:, OBSERVABLE.y1c],
        alpha2_rad=observed[:, OBSERVABLE.alpha2],
        gaze_residual_rad=observed[:, OBSERVABLE.residual],
        z_mm=observed[:, OBSERVABLE.z],
        std=std,
        shared=shared,
        shared_names=names,
    )
