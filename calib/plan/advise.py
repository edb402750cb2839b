"""The advice: which targets next, and what u(z) each would leave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from calib.core.arrays import FloatArray, IntArray
from calib.core.errors import UsageError
from calib.geometry.parameters import PARAMETERS
from calib.plan.design import (
    REGULAR,
    Knowledge,
    RowNoise,
    choose,
    d_criterion,
    depth_vectors,
    g_criterion,
    relative_variance,
    row_vectors,
    rows_at,
)
from calib.plan.field import Field

RANDOM_SETS = 100
"""Random sets whose median u(z) stands beside the advice: known to 10 % of their spread."""


@dataclass(frozen=True)
class RankedTargets:
    """Targets in the order of what each adds.

    Parameters
    ----------
    points_mm
        Frame C1, shape (count, 3).
    x1c, y1c
        Where C1 sees them, normalised, shape (count,).
    alpha2_rad
        Where C2 will stand, by the present estimate, shape (count,).
    u_rel
        Relative standard uncertainty of the asked depths, from the parameters alone, after the
        first target, the first two and so on, shape (count, depths).
    """

    points_mm: FloatArray
    x1c: FloatArray
    y1c: FloatArray
    alpha2_rad: FloatArray
    u_rel: FloatArray


@dataclass(frozen=True)
class Advice:
    """Advice on the next targets.

    Parameters
    ----------
    model
        Model whose parameters are to be learned.
    depths_mm
        Asked depths, shape (k,).
    before_rel
        Relative standard uncertainty of these depths now, shape (k,), from the parameters alone.
    random_rel
        Median over random sets of as many targets, shape (k,).
    targets
        By criterion: "G" makes the greatest u(z) at the asked depths least, "D" the volume of the
        parameters' uncertainty.
    candidates_mm
        All targets that were considered, shape (m, 3).
    """

    model: str
    depths_mm: FloatArray
    before_rel: FloatArray
    random_rel: FloatArray
    targets: Mapping[str, RankedTargets]
    candidates_mm: FloatArray


def advise(
    knowledge: Knowledge,
    field: Field,
    noise: RowNoise,
    rng: Generator,
    *,
    asked_mm: FloatArray,
    between_mm: tuple[float, float],
    count: int,
) -> Advice:
    """Return where to put `count` targets next.

    Parameters
    ----------
    asked_mm
        Depths at which u(z) is to become small, shape (k,).
    between_mm
        Least and greatest depth at which targets can be put.

    Raises
    ------
    UsageError
        If no target can be put anywhere, or an asked depth cannot be seen.
    """
    model = knowledge.model
    points = field.grid(knowledge.theta, between_mm, high=model.needs_height)
    if not len(points):
        raise UsageError(
            f"no target between {between_mm[0]:.0f} and {between_mm[1]:.0f} mm is seen by C1 at a "
            "yaw within reach; widen --targets or --yaw"
        )
    asked = depth_vectors(knowledge, field, asked_mm)
    blind = ~asked.any(axis=(1, 2))
    if blind.any():
        raise UsageError(f"--depth {asked_mm[blind][0]:g}: C1 and C2 cannot both see that depth")
    candidates = row_vectors(knowledge, rows_at(knowledge, points, noise))
    information = regular(knowledge)
    targets = {
        name: _targets(knowledge, points, candidates, asked, choose(
            information, candidates, criterion, count=count))
        for name, criterion in (("G", g_criterion(asked)), ("D", d_criterion))
    }  # fmt: skip
    random = [
        _u_rel(information, candidates[rng.choice(len(points), count)], asked)
        for _ in range(RANDOM_SETS)
    ]
    return Advice(
        model=model.name,
        depths_mm=asked_mm,
        before_rel=_u_rel(information, candidates[:0], asked),
        random_rel=np.median(random, axis=0),
        targets=targets,
        candidates_mm=points,
    )


def regular(knowledge: Knowledge) -> FloatArray:
    """Return the information before, made regular, shape (p, p)."""
    unit = np.array([PARAMETERS[i].scale for i in knowledge.model.indices])
    information: FloatArray = knowledge.information + REGULAR * np.diag(unit**-2)
    return information


def _u_rel(information: FloatArray, rows: FloatArray, asked: FloatArray) -> FloatArray:
    """Return the relative standard uncertainty of the asked depths after `rows`, shape (k,)."""
    covariance = np.linalg.inv(information + rows.T @ rows).astype(np.float64)
    u: FloatArray = np.sqrt(relative_variance(covariance, asked))
    return u


def _targets(
    knowledge: Knowledge,
    points: FloatArray,
    candidates: FloatArray,
    asked: FloatArray,
    chosen: IntArray,
) -> RankedTargets:
    information = regular(knowledge)
    own = points[chosen]
    rows = rows_at(knowledge, own, _SILENT)
    after = [_u_rel(information, candidates[chosen[: i + 1]], asked) for i in range(len(chosen))]
    return RankedTargets(
        points_mm=own,
        x1c=rows.x1c,
        y1c=rows.y1c,
        alpha2_rad=rows.alpha2_rad,
        u_rel=np.array(after),
    )


_SILENT = RowNoise(reading=np.zeros(4), z_mm=0.0, z_rel=0.0)
