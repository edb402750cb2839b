"""The one table of model parameters, and the models as sets of free ones.

Adding a parameter is one entry of `PARAMETERS`: its `Effect` says how it enters the formula of
`calib.geometry.plane`, which takes the value and the analytic jacobian from there, and what kind of
further rows identifies it. Adding a model is one entry of `MODELS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from calib.core.arrays import FloatArray

ENCODER_CENTRE_RAD = np.pi / 2
"""Reading about which the encoder's scale error turns: C2 parallel to Z of C1."""


@dataclass(frozen=True)
class EncoderTerm:
    """Adds ``parameter * basis(alpha2)`` to the gaze angle; `slope` is d(basis)/d(alpha2)."""

    basis: Callable[[FloatArray], FloatArray]
    slope: Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class AxisPoint:
    """Moves the point in which the yaw axis crosses the plane Y = 0 of C1 along a direction."""

    direction: tuple[float, float, float]


@dataclass(frozen=True)
class PlaneOffset:
    """Shifts the gaze plane along its normal, away from the yaw axis."""


@dataclass(frozen=True)
class Standoff:
    """Moves C2's centre ahead of the yaw axis along its optical axis.

    The plane of a target on C2's centre column stays where it is; that of a target off it shifts.
    """


@dataclass(frozen=True)
class ReferenceOffset:
    """Says how far in front of C1's optical centre the reference depths of rows are counted from.

    Not of the rig: it moves no depth that the rig measures, which count from the optical centre.
    """


@dataclass(frozen=True)
class AxisTilt:
    """Turns the yaw axis about an axis of C1: 0 is X, 2 is Z. Applied as R = Rz Rx."""

    about: int


@dataclass(frozen=True)
class GazeRoll:
    """Rolls C2 about its optical axis."""


Effect = EncoderTerm | AxisPoint | PlaneOffset | Standoff | ReferenceOffset | AxisTilt | GazeRoll


@dataclass(frozen=True)
class Parameter:
    """A parameter of the turning-plane model.

    Parameters
    ----------
    name
        Key in files; ends in its unit where it has one.
    symbol
        As written in the documents.
    unit
        "mm", "rad" or "1".
    meaning
        One phrase for reports.
    effect
        How it enters the formula.
    prior_std
        Standard deviation of the default normal prior about 0, in `unit`; None for a flat prior.
    scale
        A typical size of its standard uncertainty, in `unit`; conditions the optimiser.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    effect: Effect
    prior_std: float | None
    scale: float


_DEG = float(np.deg2rad(1.0))

# fmt: off
PARAMETERS: tuple[Parameter, ...] = (
    Parameter("baseline_mm", "L_b", "mm", "X of the yaw axis",
              AxisPoint((1, 0, 0)), None, 1.0),
    Parameter("delta2_rad", "δ2", "rad", "zero error of the encoder",
              EncoderTerm(np.ones_like, np.zeros_like), None, 1e-3),
    Parameter("axis_z_mm", "Z_a", "mm", "Z of the yaw axis",
              AxisPoint((0, 0, 1)), 20.0, 1.0),
    Parameter("eccentricity_mm", "e", "mm", "distance of the gaze plane from the yaw axis",
              PlaneOffset(), 10.0, 1.0),
    Parameter("axis_tilt_x_rad", "τ_x", "rad", "tilt of the yaw axis about X",
              AxisTilt(0), _DEG, 1e-3),
    Parameter("axis_tilt_z_rad", "τ_z", "rad", "tilt of the yaw axis about Z",
              AxisTilt(2), _DEG, 1e-3),
    Parameter("gaze_roll_rad", "ρ", "rad", "roll of C2 about its optical axis",
              GazeRoll(), _DEG, 1e-3),
    Parameter("encoder_scale", "k", "1", "scale error of the encoder about 90°",
              EncoderTerm(lambda a: a - ENCODER_CENTRE_RAD, np.ones_like), 0.01, 1e-2),
    Parameter("encoder_cos_rad", "ε_c", "rad", "once-per-turn error of the encoder, cosine",
              EncoderTerm(np.cos, lambda a: -np.sin(a)), 0.1 * _DEG, 1e-3),
    Parameter("encoder_sin_rad", "ε_s", "rad", "once-per-turn error of the encoder, sine",
              EncoderTerm(np.sin, np.cos), 0.1 * _DEG, 1e-3),
    Parameter("standoff_mm", "f", "mm", "C2's centre ahead of the yaw axis",
              Standoff(), 40.0, 10.0),
    Parameter("reference_offset_mm", "o", "mm", "origin of z_mm in front of C1's centre",
              ReferenceOffset(), 50.0, 10.0),
)
# fmt: on

IdentifiedBy = Literal["data", "prior", "both"]
"""Who decided an estimate: the data, the prior, or both together."""

NAMES: tuple[str, ...] = tuple(p.name for p in PARAMETERS)
INDEX: Mapping[str, int] = MappingProxyType({name: i for i, name in enumerate(NAMES)})
COUNT = len(PARAMETERS)

ECCENTRICITY = "eccentricity_mm"

GAZED_BASELINE = "baseline_at_mean_gaze_mm"
"""L_b + e / sin(α), the effective baseline at the mean reading of the rows: no parameter, but what
they determine where they cannot distinguish baseline and eccentricity."""

STANDOFF = "standoff_mm"
"""Free in every model where rows have a gaze residual, the angle at C2's centre; nowhere else."""


REFERENCE_OFFSET = "reference_offset_mm"
"""Free in every model where nobody has said from where z_mm counts; of rows alone.

Its default prior is as wide as the parts that labs measure from lie in front of the optical centre
(lens, flange, housing). Of simulated rigs with 14 and 24 rows whose depths were counted from 20 mm
off, a prior of 10 mm, even widened by what the rows ask for, kept 91 % of depths inside their 95 %
intervals; 50 mm keeps 95 %, and 94 % at 60 mm off, with intervals a fifth wider than 10 mm.
"""


@dataclass(frozen=True)
class Model:
    """A set of free parameters; the others stay at 0.

    Parameters
    ----------
    name
        Key in files.
    free
        Names of the free parameters; kept in the order of `PARAMETERS`.
    needs_height
        True if it can be fitted only to targets with y1c off zero.
    """

    name: str
    free: tuple[str, ...]
    needs_height: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "free", tuple(sorted(self.free, key=NAMES.index)))

    @property
    def indices(self) -> tuple[int, ...]:
        """Positions of the free parameters in a full parameter vector."""
        return tuple(INDEX[name] for name in self.free)


_BASE = ("baseline_mm", "delta2_rad")
_AXIS_OFFSET = (*_BASE, "axis_z_mm", "eccentricity_mm")
_TILTS = ("axis_tilt_x_rad", "axis_tilt_z_rad", "gaze_roll_rad")
_ENCODER = ("encoder_scale", "encoder_cos_rad", "encoder_sin_rad")

MODELS: Mapping[str, Model] = MappingProxyType(
    {
        model.name: model
        for model in (
            Model("base", _BASE),
            Model("axis-offset", _AXIS_OFFSET),
            Model("axis-tilt", (*_AXIS_OFFSET, *_TILTS), needs_height=True),
            Model("encoder", (*_AXIS_OFFSET, *_ENCODER)),
        )
    }
)


def model_for(name: str, *, off_centre: bool, offset_open: bool) -> Model:
    """Return a model of `MODELS` with the parameters that the rows at hand make free.

    Parameters
    ----------
    off_centre
        Whether some targets are off C2's centre column: the standoff is then free.
    offset_open
        Whether it is uncertain from where reference depths are counted: that is then free.
    """
    model = MODELS[name]
    more = (STANDOFF,) * off_centre + (REFERENCE_OFFSET,) * offset_open
    return replace(model, free=(*model.free, *more)) if more else model


def vector(values: Mapping[str, float]) -> FloatArray:
    """Return the full parameter vector, shape (COUNT,), of named values; the others are 0.

    Raises
    ------
    KeyError
        If a name is not one of `NAMES`.
    """
    theta = np.zeros(COUNT)
    for name, value in values.items():
        theta[INDEX[name]] = value
    return theta


def embed(free: FloatArray, names: Sequence[str]) -> FloatArray:
    """Return full parameter vectors, shape (..., COUNT), of free ones, shape (..., len(names))."""
    theta = np.zeros((*free.shape[:-1], COUNT))
    theta[..., [INDEX[name] for name in names]] = free
    return theta
