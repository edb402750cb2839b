"""What the calibration starts from, in the mirror."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.fit.priors import MeasuredParameters, Priors
from calib.geometry.mirror import (
    OBSERVABLE_SIGN,
    mirror_camera,
    mirror_matrix,
    mirror_readings,
    shared_signs,
    signed,
    signs,
)
from calib.rows.common_errors import FRESH, CommonErrors
from calib.rows.from_table import CameraSet, Setup, ValidationRows
from calib.rows.observations import Observations


@dataclass(frozen=True)
class Mirror:
    """The mirror of a rig's problem.

    Parameters
    ----------
    common
        Signs of the k standard-normal errors that all rows share, shape (k,). In the mirror each
        moves the first quantity of its own upwards, as `CommonErrors.of` has it on either side.
    """

    common: FloatArray

    @classmethod
    def of(cls, shared: CommonErrors) -> Mirror:
        """Return the mirror for a rig's shared errors."""
        # What is left of rounding before a column's first quantity moves nothing.
        size = np.linalg.norm(shared.factor, axis=1, keepdims=True)
        moved = np.abs(shared.factor) > FRESH / 2 * size
        first = moved.argmax(axis=0) if len(moved) else np.zeros(0, dtype=np.int64)
        return cls(shared_signs([shared.names[i] for i in first]))

    def columns(self, count: int) -> FloatArray:
        """Return the signs of so many errors: what groups of rows share besides is even."""
        return np.append(self.common, np.ones(count - len(self.common)))

    def shared(self, shared: CommonErrors) -> CommonErrors:
        """Return the shared errors of intrinsics and pose of C2."""
        sign = np.outer(shared_signs(shared.names), self.common)
        return replace(shared, factor=signed(shared.factor, sign))

    def setup(self, setup: Setup) -> Setup:
        """Return what holds for all rows."""
        c1, c2 = (
            None if camera is None else mirror_camera(camera)
            for camera in (setup.cameras.c1, setup.cameras.c2)
        )
        return replace(setup, cameras=CameraSet(c1, c2), shared=self.shared(setup.shared))

    def rows(self, rows: Observations) -> Observations:
        """Return rows as the rig in the mirror has them."""
        shared = rows.shared
        if rows.shared_names:
            shared = signed(shared, np.outer(OBSERVABLE_SIGN, self.common))
        alone = rows.alone
        if rows.alone_names:
            alone = signed(alone, np.array(OBSERVABLE_SIGN)[:, None])
        return replace(
            rows,
            x1c=signed(rows.x1c, -1.0),
            alpha2_rad=mirror_readings(rows.alpha2_rad),
            gaze_residual_rad=signed(rows.gaze_residual_rad, -1.0),
            shared=shared,
            alone=alone,
        )

    def validation(self, validation: ValidationRows) -> ValidationRows:
        """Return validation rows; depths are the same in a mirror."""
        return replace(validation, rows=self.rows(validation.rows))


def mirror_priors(priors: Priors) -> Priors:
    """Return prior and measured knowledge of the parameters."""
    sign = dict(zip(priors.stated, signs(priors.stated).tolist(), strict=True))
    stated = {name: (sign[name] * mean + 0.0, std) for name, (mean, std) in priors.stated.items()}
    return Priors(stated, None if priors.measured is None else _measured(priors.measured))


def _measured(measured: MeasuredParameters) -> MeasuredParameters:
    sign = signs(measured.names)
    return replace(
        measured,
        mean=signed(measured.mean, sign),
        covariance=mirror_matrix(measured.covariance, sign),
    )
