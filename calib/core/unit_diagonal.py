"""Symmetric matrices whose unknowns have units of their own, brought to unit diagonal.

A covariance in mm² and rad² has elements many powers of ten apart; what hangs on the size of an
eigenvalue (rank, condition, a direction without spread) is asked of the correlations (Jacobi's
scaling: A. van der Sluis, Numer. Math. 14, 14-23, 1969, doi:10.1007/BF02165096).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.arrays import FloatArray


def unit_diagonal(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the square roots s of the diagonal, shape (n,), and matrix / (s s'), shape (n, n).

    Of a covariance these are the standard uncertainties and the correlations. Where the diagonal
    is not above 0 s is 1, so that nothing is divided by it.
    """
    diagonal = np.diagonal(matrix)
    scale: FloatArray = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    return scale, matrix / np.outer(scale, scale)


@dataclass(frozen=True)
class Spectrum:
    """A symmetric matrix as S V diag(values) V' S, its middle part of unit diagonal.

    Attributes
    ----------
    scale
        Diagonal of S, shape (n,).
    values
        Eigenvalues of the middle part, ascending, shape (n,).
    vectors
        Its eigenvectors V, in columns, shape (n, n).
    """

    scale: FloatArray
    values: FloatArray
    vectors: FloatArray

    @classmethod
    def of(cls, matrix: FloatArray) -> Spectrum:
        """Take a symmetric matrix, shape (n, n), apart."""
        scale, scaled = unit_diagonal(matrix)
        return cls(scale, *np.linalg.eigh(scaled))

    @property
    def span(self) -> float:
        """Smallest eigenvalue over the largest: what rounding, or 0 or less, tells of no rank."""
        return float(self.values[0] / self.values[-1]) if self.values[-1] > 0 else 0.0

    def root(self, least: float | None = None) -> FloatArray:
        """Return A with A A' the matrix.

        Without `least` its shape is (n, n), and eigenvalues below 0, of rounding, are taken as 0;
        with it the shape is (n, r), without directions of at most that share of the largest one.
        """
        if least is None:
            values, vectors = np.maximum(self.values, 0), self.vectors
        else:
            values, vectors = self._above(least)
        found: FloatArray = self.scale[:, None] * vectors * np.sqrt(values)
        return found

    def inverse_root(self, least: float) -> FloatArray:
        """Return W, shape (n, r), W W' the inverse but for directions of at most that share."""
        values, vectors = self._above(least)
        found: FloatArray = vectors / np.sqrt(values) / self.scale[:, None]
        return found

    def inverse(self) -> FloatArray:
        """Return the inverse, shape (n, n); the caller has looked at `span`."""
        found: FloatArray = (
            (self.vectors / self.values) @ self.vectors.T / np.outer(self.scale, self.scale)
        )
        return found

    def _above(self, least: float) -> tuple[FloatArray, FloatArray]:
        kept = self.values > least * max(float(self.values[-1]) if len(self.values) else 0.0, 0.0)
        return self.values[kept], self.vectors[:, kept]
