"""A rig with known truth: both cameras, the yaw axis and the noise of everything measured.

C2 turns rigidly about the yaw axis. Its image x axis is the normal n of the gaze plane of
`calib.geometry.plane`; its centre stands at p + e n + h y + f g, where p is the point in which the
axis crosses Y = 0 of C1, e the eccentricity, y and g C2's image y axis and optical axis, h a height
and f the standoff. Height and pitch leave the gaze plane where it is: the model has no parameter
for them, but images show them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.camera import Camera
from calib.geometry.mirror import SIGN, mirror_camera, signed
from calib.geometry.parameters import (
    INDEX,
    MODELS,
    PARAMETERS,
    REFERENCE_OFFSET,
    STANDOFF,
    vector,
)
from calib.geometry.plane import Gaze, frame, gaze_angle

BASELINE_RANGE_MM = (60.0, 400.0)
"""From the 77 mm of Xu and Wang to what one tripod bar carries; drawn log-uniformly."""

ZERO_ERROR_STD_RAD = float(np.deg2rad(1.0))
"""Spread of the encoder's zero error: a yaw axis set by eye. The model's prior of it is flat."""

NARROWEST_FIELD_DEG, WIDEST_FIELD_DEG = 60.0, 165.0
"""Of a wide lens, along the diagonal: beyond, a corner of the imager may look sideways or back."""

FIELD_OF_VIEW_DEG = (45.0, 62.0)
"""Horizontal; lenses of 4 to 6 mm on a 1/3'' imager."""

RESOLUTIONS_DEG = (0.05625, 0.036, 0.018, 0.009)
"""Stepper of 0.9 degrees with 16 microsteps (the paper's), encoders of 10,000 to 40,000 counts."""

YAW_RANGE_RAD = (float(np.deg2rad(40.0)), float(np.deg2rad(140.0)))
"""Readings that C2's cables and mount allow."""

STANDOFF_RANGE_MM = (-20.0, 60.0)
"""C2's centre behind or ahead of its yaw axis."""

NEAR_BASELINES, FAR_BASELINES = 5.0, 12.0
"""Working depths in baselines; the paper's Table 1 spans 6.3 to 13."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the errors of what is measured.

    Parameters
    ----------
    pixel_px
        A point in an image of either camera, each coordinate, px.
    encoder_rad
        Where the motor stands against its count, rad; the rounding to counts comes on top.
    z_mm, z_rel
        A row's own error of the reference depth, absolute and relative to the depth.
    shared_focal, shared_centre, shared_z_rel
        Errors common to all rows: C1's focal length (relative), C1's principal point (as a
        normalised coordinate, each direction), the scale of the reference depth (relative).
    """

    pixel_px: float = 0.1
    encoder_rad: float = 0.0
    z_mm: float = 0.0
    z_rel: float = 0.001
    shared_focal: float = 0.0
    shared_centre: float = 0.0
    shared_z_rel: float = 0.0


@dataclass(frozen=True)
class TrueRig:
    """The truth about a rig.

    Parameters
    ----------
    model
        The model of `calib.geometry.parameters.MODELS` it was drawn from.
    theta
        True parameters of the whole family, shape (COUNT,).
    c1, c2
        The cameras.
    resolution_rad
        One count of the encoder or microstep of the motor, rad.
    height_mm
        C2's centre down its image y axis from the axis point, mm.
    pitch_rad
        Turn of C2 about its image x axis, rad, positive looking up.
    yaw_range_rad
        Readings within reach, rad.
    noise
        Of the measured quantities.
    """

    model: str
    theta: FloatArray
    c1: Camera
    c2: Camera
    resolution_rad: float
    height_mm: float
    pitch_rad: float
    yaw_range_rad: tuple[float, float]
    noise: Noise

    @property
    def is_left(self) -> bool:
        """Whether C2 stands at -X of C1."""
        return bool(self.theta[INDEX["baseline_mm"]] < 0)

    @property
    def depth_range_mm(self) -> tuple[float, float]:
        """Depths at which such a rig works, mm: so many baselines."""
        baseline = abs(float(self.theta[INDEX["baseline_mm"]]))
        return NEAR_BASELINES * baseline, FAR_BASELINES * baseline

    @property
    def forward_mm(self) -> float:
        """C2's centre ahead of the axis along its optical axis, mm."""
        return float(self.theta[INDEX[STANDOFF]])

    @property
    def mount_mm(self) -> FloatArray:
        """C2's centre as seen from the axis point p, in C2's own axes, mm, shape (3,)."""
        eccentricity = float(self.theta[INDEX["eccentricity_mm"]])
        return np.array([eccentricity, self.height_mm, self.forward_mm])


@dataclass(frozen=True)
class AxisInC2:
    """The yaw axis as C2 sees it, the same at every reading.

    Parameters
    ----------
    direction
        Unit vector in C2's frame, shape (3,), near +Y.
    foot_mm
        Foot of the perpendicular from C2's centre on the axis, C2's frame, mm, shape (3,).
    """

    direction: FloatArray
    foot_mm: FloatArray


def c2_pose(rig: TrueRig, reading: FloatArray) -> FloatArray:
    """Return 1T2, the pose of C2 in C1, shape (..., 4, 4), mm.

    Parameters
    ----------
    reading
        Encoder readings at which C2 stands, rad, shape (...).
    """
    flat = np.atleast_1d(np.asarray(reading, dtype=float)).ravel()
    still = np.zeros_like(flat)
    angle = gaze_angle(rig.theta, Gaze(still, still, flat, still))
    f = frame(rig.theta)
    u, v, w = f.basis()
    sin, cos = np.sin(angle)[:, None], np.cos(angle)[:, None]
    normal = sin * u + cos * v + w
    level = -cos * f.rotation[:, 0] + sin * f.rotation[:, 2]
    down = np.cross(level, normal)
    turn = np.stack([normal, down, level], axis=-1) @ _about_x(rig.pitch_rad)
    pose = np.zeros((len(flat), 4, 4))
    pose[:, :3, :3] = turn
    pose[:, :3, 3] = f.point + turn @ rig.mount_mm
    pose[:, 3, 3] = 1
    return pose.reshape(*np.shape(reading), 4, 4)


def yaw_axis_in_c2(rig: TrueRig) -> AxisInC2:
    """Return the yaw axis in C2's frame, what a yaw sweep of images measures."""
    pose = c2_pose(rig, np.array(np.pi / 2))
    direction = pose[:3, :3].T @ frame(rig.theta).rotation[:, 1]
    point = -rig.mount_mm
    return AxisInC2(direction, point - (point @ direction) * direction)


def _about_x(angle: float) -> FloatArray:
    sin, cos = np.sin(angle), np.cos(angle)
    return np.array([[1.0, 0, 0], [0, cos, -sin], [0, sin, cos]])


def draw_rig(
    rng: np.random.Generator,
    *,
    model: str,
    fixed: Mapping[str, float] | None = None,
    image_size: tuple[int, int] = (1280, 960),
    noise: Noise | None = None,
) -> TrueRig:
    """Draw a plausible rig.

    Free parameters of the model which have a default prior are drawn from it, so that rigs are
    what the posterior expects of them; the others are 0. The baseline is log-uniform over
    `BASELINE_RANGE_MM`, the zero error normal, the standoff uniform over `STANDOFF_RANGE_MM`
    whatever the model.

    Parameters
    ----------
    model
        Name in `MODELS`.
    fixed
        Parameters set to a value instead, by name; any of the family.
    image_size
        Of both cameras, width and height, px.
    noise
        Instead of drawn noise: 0.03 to 0.2 px, 0.05 to 0.3 % in depth, log-uniform; the motor
        stands within 0.02 mrad of its count; nothing shared.

    Raises
    ------
    KeyError
        If the model or a fixed parameter is unknown.
    """
    drawn_parameters = _draw_parameters(rng, model)
    drawn = Noise(
        pixel_px=_log_uniform(rng, 0.03, 0.2),
        encoder_rad=2e-5,
        z_rel=_log_uniform(rng, 0.0005, 0.003),
    )
    c1, c2 = (draw_camera(rng, image_size=image_size) for _ in range(2))
    resolution = float(np.deg2rad(rng.choice(RESOLUTIONS_DEG)))
    drawn_parameters[STANDOFF] = float(rng.uniform(*STANDOFF_RANGE_MM))
    return TrueRig(
        model=model,
        theta=vector(drawn_parameters | dict(fixed or {})),
        c1=c1,
        c2=c2,
        resolution_rad=resolution,
        height_mm=float(rng.normal(0, 5)),
        pitch_rad=float(rng.normal(0, np.deg2rad(0.5))),
        yaw_range_rad=YAW_RANGE_RAD,
        noise=noise or drawn,
    )


def mirror_rig(rig: TrueRig) -> TrueRig:
    """Return the rig as a mirror shows it: C2 on the other side of C1, depths as they were."""
    low, high = rig.yaw_range_rad
    return replace(
        rig,
        theta=signed(rig.theta, SIGN),
        c1=mirror_camera(rig.c1),
        c2=mirror_camera(rig.c2),
        yaw_range_rad=(float(np.pi - high), float(np.pi - low)),
    )


def draw_camera(rng: np.random.Generator, *, image_size: tuple[int, int]) -> Camera:
    """Draw a camera with the five-parameter lens.

    The field of view is uniform over `FIELD_OF_VIEW_DEG`, pixels are square to 0.2 %, the principal
    point is off centre by 1 % of the width. The lens moves the corner of the imager by -12 to +2 %
    of its radius, nearly all by k1; k2 and k3 are so small that the model stays one to one well
    beyond the imager.
    """
    width, height = image_size
    focal = width / 2 / np.tan(np.deg2rad(rng.uniform(*FIELD_OF_VIEW_DEG)) / 2)
    matrix = np.eye(3)
    matrix[0, 0], matrix[1, 1] = focal * (1 + rng.normal(0, 0.002, 2))
    matrix[:2, 2] = rng.normal([(width - 1) / 2, (height - 1) / 2], 0.01 * width)
    corner = np.hypot(width, height) / 2 / focal
    k1 = rng.uniform(-0.12, 0.02) / corner**2
    k2 = -k1 * rng.uniform(0, 0.3) / corner**2
    k3 = rng.normal(0, 0.002) / corner**6
    p1, p2 = rng.normal(0, 3e-4, 2)
    return Camera(matrix, np.array([k1, k2, p1, p2, k3]), image_size)


def draw_wide_camera(
    rng: np.random.Generator, *, field_deg: float, image_size: tuple[int, int]
) -> Camera:
    """Draw a camera with an equidistant lens.

    Parameters
    ----------
    field_deg
        Full field of view along the image's diagonal, deg, below `WIDEST_FIELD_DEG`.
    """
    half = np.deg2rad(field_deg) / 2
    # Coefficients move the rim by up to 5 % and leave the field as it was asked for.
    k1, k2, k3, k4 = rng.uniform(-1, 1, 4) * (0.03, 0.01, 0.005, 0.002) / half ** np.arange(2, 9, 2)
    rim = 1 + k1 * half**2 + k2 * half**4 + k3 * half**6 + k4 * half**8
    focal = np.hypot(*image_size) / 2 / (half * rim)
    matrix = np.eye(3)
    matrix[0, 0], matrix[1, 1] = focal * (1 + rng.normal(0, 0.001, 2))
    width, height = image_size
    matrix[:2, 2] = rng.normal([(width - 1) / 2, (height - 1) / 2], 0.003 * width)
    return Camera(matrix, np.array([k1, k2, k3, k4]), image_size, "equidistant")


def _draw_parameters(rng: np.random.Generator, model: str) -> dict[str, float]:
    """Draw the free parameters of a model, by name."""
    drawn = {
        "baseline_mm": _log_uniform(rng, *BASELINE_RANGE_MM),
        "delta2_rad": float(rng.normal(0, ZERO_ERROR_STD_RAD)),
    }
    free = MODELS[model].free
    for parameter in PARAMETERS:
        # Drawn for every model alike: the same seed gives rigs that differ in nothing else.
        if parameter.prior_std is not None and parameter.name not in (STANDOFF, REFERENCE_OFFSET):
            value = float(rng.normal(0, parameter.prior_std))
            if parameter.name in free:
                drawn[parameter.name] = value
    return drawn


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
