"""What a set of rows can tell of a model, and which combination of parameters it cannot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from calib.arrays import FloatArray
from calib.fit.noise import EFFICIENCY, is_outlier, row_noise
from calib.fit.priors import Priors, measured_of, prior_of
from calib.fit.robust import RobustFit
from calib.gates import Gate
from calib.geometry.parameters import MODELS, PARAMETERS, Model
from calib.geometry.plane import closure, depth_jacobian
from calib.observations import Observations

UNDETERMINED = 10.0
"""Standard deviation, in units of `Parameter.scale`, of a combination which the rows leave open:
10 mm or 10 mrad are what a ruler and the eye tell without any calibration."""

PREDICTED_LIMIT_REL = 0.05
"""Relative standard deviation of depth, from the parameters alone, at the rows' own depths. Above
it the calibration is not worth its rows: the paper's own errors are 8 % and less."""

INVOLVED = 0.25
"""Least share of a unit vector's length at which a parameter is named as part of it."""


@dataclass(frozen=True)
class Combination:
    """A direction in parameter space, as the rows alone see it.

    Parameters
    ----------
    names
        Parameters that make it up, the largest part first.
    direction
        Unit vector in units of `Parameter.scale`, shape (p,).
    singular_value
        Square root of the information along it: 1 / standard deviation.
    std
        Standard deviation along it, in units of `Parameter.scale`; infinite if nothing is known.
    std_with_priors
        The same with priors and measured knowledge.
    words
        What the rows cannot tell and what to do about it; empty where they can.
    """

    names: tuple[str, ...]
    direction: FloatArray
    singular_value: float
    std: float
    std_with_priors: float
    words: str


@dataclass(frozen=True)
class Identifiability:
    """What the rows can tell of one model.

    Parameters
    ----------
    model
        Its name.
    names
        Free parameters, p of them.
    combinations
        Principal directions of the scaled Fisher information, the best known first; p of them.
    correlation
        Of the parameters with priors and measured knowledge, shape (p, p).
    data_std
        Standard deviations from the rows alone, shape (p,), units of the parameters; infinite
        where the rows leave a parameter open.
    std
        With priors and measured knowledge, shape (p,).
    depth_std_rel
        Greatest relative standard deviation of depth, from the parameters alone, over the rows.
    gate
        Whether that is small enough. Large correlations alone fail nothing.
    """

    model: str
    names: tuple[str, ...]
    combinations: tuple[Combination, ...]
    correlation: FloatArray
    data_std: FloatArray
    std: FloatArray
    depth_std_rel: float
    gate: Gate

    @property
    def condition(self) -> float:
        """Condition number of the scaled information's root."""
        last = self.combinations[-1].singular_value
        return self.combinations[0].singular_value / last if last > 0 else float("inf")


def identifiability(rows: Observations, fit: RobustFit, priors: Priors) -> Identifiability:
    """Return what `rows` can tell of the model of `fit`, at its estimate."""
    model = MODELS[fit.model]
    unit = np.array([PARAMETERS[i].scale for i in model.indices])
    data = row_information(rows, fit) * np.outer(unit, unit)
    known = prior_of(model, priors).precision + measured_of(model, priors).precision
    together = data + known * np.outer(unit, unit)
    covariance: FloatArray = np.linalg.pinv(together, hermitian=True).astype(np.float64)
    value, vectors = np.linalg.eigh(data)
    combinations = tuple(
        _combination(model, rows, float(value[k]), vectors[:, k], covariance, float(value[-1]))
        for k in range(len(unit) - 1, -1, -1)
    )
    std = np.sqrt(np.diag(covariance))
    jacobian = depth_jacobian(fit.theta, rows.gaze)
    slope = jacobian.by_theta[:, list(model.indices)] * unit
    relative = np.sqrt(np.einsum("ni,ij,nj->n", slope, covariance, slope)) / np.abs(jacobian.z)
    worst = float(relative.max())
    return Identifiability(
        model=model.name,
        names=model.free,
        combinations=combinations,
        correlation=covariance / np.outer(std, std),
        data_std=_data_std(value, vectors) * unit,
        std=std * unit,
        depth_std_rel=worst,
        gate=_gate(model, worst, combinations),
    )


def row_information(rows: Observations, fit: RobustFit) -> FloatArray:
    """Return the rows' Fisher information at a fit, (p, p), per unit of the free parameters.

    Outliers are left out; the noise is what the fit found, its efficiency that of the t density.
    """
    c = closure(fit.theta, rows.gaze, rows.z_mm)
    sigma = row_noise(fit.theta, rows).sigma
    slope = c.by_theta[:, list(MODELS[fit.model].indices)] / (sigma * fit.noise_scale)[:, None]
    slope = slope[~is_outlier(c.value / sigma, fit.noise_scale)]
    information: FloatArray = EFFICIENCY * slope.T @ slope
    return information


NOTHING = 1e-14
"""Share of the largest eigenvalue below which rounding has made an eigenvalue of nothing."""


def _data_std(value: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return standard deviations, shape (p,), from an eigen decomposition of the information."""
    open_to = value <= NOTHING * max(float(value[-1]), 1e-300)
    variance = (vectors[:, ~open_to] ** 2 / value[~open_to]).sum(axis=1)
    lost = (vectors[:, open_to] ** 2).sum(axis=1) > INVOLVED**4
    std: FloatArray = np.where(lost, np.inf, np.sqrt(variance))
    return std


def _combination(
    model: Model,
    rows: Observations,
    value: float,
    direction: FloatArray,
    covariance: FloatArray,
    largest: float,
) -> Combination:
    singular = float(np.sqrt(value)) if value > NOTHING * max(largest, 1e-300) else 0.0
    std = 1 / singular if singular > 0 else float("inf")
    order = np.argsort(-np.abs(direction))
    names = tuple(model.free[i] for i in order if abs(direction[i]) > INVOLVED)
    return Combination(
        names=names,
        direction=direction,
        singular_value=singular,
        std=std,
        std_with_priors=float(np.sqrt(direction @ covariance @ direction)),
        words=_words(names, rows) if std > UNDETERMINED else "",
    )


_SYMBOLS: Mapping[str, str] = MappingProxyType({p.name: p.symbol for p in PARAMETERS})


def _words(names: tuple[str, ...], rows: Observations) -> str:
    """Return what the rows cannot tell, and the next step."""
    symbols = [_SYMBOLS[name] for name in names]
    if len(symbols) == 1:
        told = f"these targets say hardly anything of {symbols[0]}"
    else:
        told = f"these targets cannot tell {', '.join(symbols[:-1])} from {symbols[-1]}"
    return f"{told}: {' or '.join(_remedies(names, rows))}"


def _remedies(names: tuple[str, ...], rows: Observations) -> list[str]:
    """Return what would help, the likeliest first."""
    low, high = np.rad2deg([rows.alpha2_rad.min(), rows.alpha2_rad.max()])
    near, far = rows.z_mm.min(), rows.z_mm.max()
    found = []
    if any(name in names for name in ("eccentricity_mm", "axis_z_mm")) or any(
        name.startswith("encoder") for name in names
    ):
        found.append(f"sweep wider than {low:.0f} to {high:.0f} deg")
    if any(name in names for name in ("axis_tilt_x_rad", "axis_tilt_z_rad", "gaze_roll_rad")):
        span = float(np.ptp(rows.y1c))
        found.append(f"place targets higher and lower (y1c spans {span:.2f} now)")
    if "delta2_rad" in names or not found:
        found.append(f"place targets nearer and farther than {near:.0f} to {far:.0f} mm")
    prior = next((n for n in reversed(PRIOR_ORDER) if n in names), names[-1])
    found.append(f"give a prior of {prior} in dataset.toml")
    return found


PRIOR_ORDER = tuple(parameter.name for parameter in PARAMETERS)
"""Of several parameters the last in the table is the one a drawing or a sweep tells best."""


def _gate(model: Model, worst: float, combinations: tuple[Combination, ...]) -> Gate:
    passed = worst <= PREDICTED_LIMIT_REL
    detail = (
        f"the parameters of {model.name} leave depth uncertain by {100 * worst:.2g} % at most "
        f"over the rows (limit {100 * PREDICTED_LIMIT_REL:.0f} %)"
    )
    words = [c.words for c in combinations if c.words]
    if not passed and words:
        detail += "; " + "; ".join(words)
    return Gate(f"identifiability {model.name}", passed=passed, detail=detail)
