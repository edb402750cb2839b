"""Errors that all rows have in common, taken apart by where they come from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from calib.core.arrays import FloatArray
from calib.core.unit_diagonal import Spectrum, unit_diagonal
from calib.geometry.camera import Camera, intrinsic_names

SOURCES = {
    "c1": "intrinsics of C1",
    "c2": "intrinsics of C2",
    "r12": "pose of C2 (stereo reference)",
    "t12": "pose of C2 (stereo reference)",
}
"""Sources of shared errors, by the part of a quantity's name before the dot."""

RANK = 1e-12
"""Directions with a smaller share of the greatest variance are rounding errors."""

FRESH = 1e-9
"""What is left of a unit row below this is rounding: it begins no error of its own."""


@dataclass(frozen=True)
class CommonErrors:
    """What all rows have wrong together: once-estimated intrinsics and stereo extrinsics.

    Parameters
    ----------
    names
        Of the estimated quantities, e.g. ``c1.fx``; q of them.
    factor
        Shape (q, k): the errors of the quantities are ``factor @ common`` with k independent
        standard-normal errors.
    error_names
        Where each of the k errors comes from; those of one source share its name.
    """

    names: tuple[str, ...] = ()
    factor: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    error_names: tuple[str, ...] = ()

    @classmethod
    def of(cls, names: tuple[str, ...], covariance: FloatArray) -> CommonErrors:
        """Return the shared errors of quantities with a covariance, shape (q, q).

        Quantities without uncertainty are left out, directions without any too. The factor is lower
        triangular (Cholesky's, but of any rank): an error belongs to the source of the first
        quantity that it moves, and moves those after it as far as they are correlated with that
        one. So the sources add up in quadrature. A later one stands for what is uncertain of it
        once the earlier are known: the pose of C2 for what the intrinsics do not explain of it.
        """
        uncertain = np.diag(covariance) > 0
        kept = covariance[np.ix_(uncertain, uncertain)]
        if not len(kept):
            return cls()
        known = tuple(n for n, u in zip(names, uncertain, strict=True) if u)
        std, correlation = unit_diagonal(kept)
        factor, first = _triangular(Spectrum.of(correlation).root(least=RANK))
        return cls(known, std[:, None] * factor, tuple(_source(known[i]) for i in first))

    def of_camera(self, prefix: str, camera: Camera) -> FloatArray:
        """Return the factor's rows of a camera's intrinsics, shape (4 + k, common); 0 if known."""
        names = [f"{prefix}.{name}" for name in intrinsic_names(camera)]
        rows = np.zeros((len(names), self.factor.shape[1]))
        for i, name in enumerate(names):
            if name in self.names:
                rows[i] = self.factor[self.names.index(name)]
        return rows


def _triangular(root: FloatArray) -> tuple[FloatArray, tuple[int, ...]]:
    """Return a root, shape (q, k), of unit rows, turned until it is lower triangular.

    Turning leaves root @ root.T as it is. Returned too is the row at which each column begins; its
    entry there is positive, which makes the result unique. Gram and Schmidt's way, each row twice:
    once more than that changes nothing (Giraud et al. 2005, doi 10.1007/s00211-005-0615-4).
    """
    axes, first = np.zeros((0, root.shape[1])), []
    for i, row in enumerate(root):
        rest = row
        for _ in range(2):
            rest = rest - (rest @ axes.T) @ axes
        length = float(np.linalg.norm(rest))
        if length > FRESH:
            axes = np.vstack([axes, rest / length])
            first.append(i)
    return root @ axes.T, tuple(first)


def _source(name: str) -> str:
    """Return the source of the error of a quantity; its own name where it belongs to none."""
    return SOURCES.get(name.partition(".")[0], name)
