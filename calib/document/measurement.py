"""calibration.json: all that measuring needs, which holds nothing that it could not truly say."""

from __future__ import annotations

from operator import not_
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from calib.core.arrays import FloatArray
from calib.document.cameras import MeasuringCamera
from calib.document.part import FinitePart, Matrix, NotNegative, Positive, Vector
from calib.geometry.parameters import NAMES

SYMMETRY = 1e-9
"""Asymmetry of a correlation that is rounding: the file gives twelve digits."""

SUM_OF_WEIGHTS = 1e-6
"""Difference of a sum of weights from 1 that is rounding."""


class Spread(FinitePart):
    """Standard deviation of a normal part and full width of a rectangular one."""

    normal: NotNegative
    width: NotNegative


class Stated(FinitePart):
    """What the manifest states of readings."""

    u_x1c: NotNegative
    encoder_step_rad: NotNegative
    u_alpha2_rad: NotNegative


class Reading(FinitePart):
    """Errors of a reading."""

    x1c: Spread
    y1c: Spread
    alpha2_rad: Spread
    gaze_residual_rad: Spread


class Shared(FinitePart):
    """Errors that readings have in common with the rows."""

    names: tuple[str, ...]
    factor: Matrix
    with_parameters: Matrix
    sources: tuple[str, ...] | None = None


class SharedByRows(FinitePart):
    """Errors that the rows alone have in common."""

    with_parameters: Matrix
    sources: tuple[str, ...]


class ModelPart(FinitePart):
    """One model as it measures."""

    model: str
    names: tuple[str, ...] = Field(description="order of values and covariance")
    values: Vector = Field(description="of the parameters")
    covariance: Matrix
    noise_factor: Positive = Field(
        description="by how much the rows proved the stated uncertainties of a reading too small"
    )
    factor95: Positive = Field(description="coverage factor of inverse depth")

    @model_validator(mode="after")
    def _are_parameters(self) -> Self:
        size = len(self.names)
        if len(set(self.names)) != size or not set(self.names) <= set(NAMES):
            raise ValueError("names are not parameters, each once")
        shapes = {len(self.values), len(self.covariance), *map(len, self.covariance)}
        if shapes != {size}:
            raise ValueError("names, values and covariance do not belong together")
        if not _is_covariance(np.array(self.covariance)):
            raise ValueError("the covariance is not symmetric, or has a negative variance")
        return self


class AveragePart(ModelPart):
    """One model in the average."""

    weight: Annotated[float, Field(ge=0, le=1)]
    with_parameters: Matrix | None = None


class ByOneModel(ModelPart):
    """All that measuring by one model needs."""

    stated: Stated
    reading: Reading
    calibrated_depth_mm: tuple[Positive, Positive] = Field(
        description="ends of the depths that the calibration covers"
    )
    shared: Shared | None = None
    shared_by_rows: SharedByRows | None = None

    @property
    def loads(self) -> int:
        """How many errors readings share with the calibration."""
        return 0 if self.shared is None else len(self.shared.factor[0])

    @model_validator(mode="after")
    def _belongs_together(self) -> Self:
        size = len(self.names)
        if self.calibrated_depth_mm[0] > self.calibrated_depth_mm[1]:
            raise ValueError("the calibrated depths end before they begin")
        if self.shared is not None:
            errors = {len(row) for row in (*self.shared.factor, *self.shared.with_parameters)}
            counts = len(self.shared.factor), len(self.shared.with_parameters)
            if len(errors) != 1 or counts != (len(self.shared.names), size):
                raise ValueError("names and arrays of the shared errors do not belong together")
            if self.shared.sources is not None and {len(self.shared.sources)} != errors:
                raise ValueError("sources of the shared errors do not belong to them")
        if self.shared_by_rows is not None:
            rows = self.shared_by_rows.with_parameters
            errors = {len(self.shared_by_rows.sources)}
            if len(rows) != size or {len(row) for row in rows} != errors:
                raise ValueError("errors that rows share and parameters do not belong together")
        return self


class AdjustedMeasurement(ByOneModel):
    """All that measuring by the adjustment needs."""

    cameras: dict[Literal["c1", "c2"], MeasuringCamera]


class Measurement(ByOneModel):
    """All that measuring needs: by the rows, of the selected model; by the adjustment."""

    average: tuple[AveragePart, ...] = Field((), exclude_if=not_)
    adjustment: AdjustedMeasurement | None = None

    @model_validator(mode="after")
    def _shares_belong_to_it(self) -> Self:
        if self.average and abs(sum(share.weight for share in self.average) - 1) > SUM_OF_WEIGHTS:
            raise ValueError("the models' weights do not add up to 1")
        for share in self.average:
            links = share.with_parameters or ((),) * len(share.names)
            if len(links) != len(share.names) or set(map(len, links)) != {self.loads}:
                raise ValueError(f"shared errors and parameters of {share.model} do not match")
        return self


def _is_covariance(covariance: FloatArray) -> bool:
    diagonal = np.diag(covariance)
    if np.any(diagonal < 0):
        return False
    unit = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    correlation = covariance / np.outer(unit, unit)
    symmetric = np.abs(correlation - correlation.T).max(initial=0.0) <= SYMMETRY
    return bool(symmetric and np.linalg.eigvalsh(correlation).min(initial=0.0) >= -SYMMETRY)
