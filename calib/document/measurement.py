"""calibration.json: all that measuring needs, which holds nothing that it could not truly say."""

from __future__ import annotations

from operator import not_
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from calib.core.arrays import FloatArray
from calib.core.unit_diagonal import unit_diagonal
from calib.document.cameras import MeasuringCamera
from calib.document.part import FinitePart, Matrix, NotNegative, Positive, Vector
from calib.geometry.parameters import NAMES

SYMMETRY = 1e-9
"""Asymmetry of a correlation that is rounding: the file gives twelve digits."""

SUM_OF_WEIGHTS = 1e-6
"""Difference of a sum of weights from 1 that is rounding."""


class Spread(FinitePart):
    """Standard deviation of a normal part and full width of a rectangular one."""

    normal: NotNegative = Field(description="standard uncertainty of the normal part")
    width: NotNegative = Field(description="full width of the rectangular part")


class Stated(FinitePart):
    """What the manifest states of readings."""

    u_x1c: NotNegative = Field(description="standard uncertainty of x1c, 1")
    encoder_step_rad: NotNegative = Field(description="step of the encoder, rad")
    u_alpha2_rad: NotNegative = Field(
        description="standard uncertainty of a reading beyond its step, rad"
    )


class Reading(FinitePart):
    """Errors of a reading."""

    x1c: Spread = Field(description="of the normalised coordinate, 1")
    y1c: Spread = Field(description="of the normalised coordinate, 1")
    alpha2_rad: Spread = Field(description="of the encoder's reading, rad")
    gaze_residual_rad: Spread = Field(
        description="of the angle of the target from C2's centre column, rad"
    )


class Shared(FinitePart):
    """Errors that readings have in common with the rows."""

    names: tuple[str, ...] = Field(
        description="of the quantities that err in common: intrinsics and pose of the cameras"
    )
    factor: Matrix = Field(description="of their covariance: quantities by independent errors")
    with_parameters: Matrix = Field(
        description="by how much one unit of each error moved each parameter"
    )
    sources: tuple[str, ...] | None = Field(
        None, description="where each error comes from; absent in older files"
    )


class SharedByRows(FinitePart):
    """Errors that the rows alone have in common."""

    with_parameters: Matrix = Field(
        description="by how much one unit of each error moved each parameter"
    )
    sources: tuple[str, ...] = Field(description="where each error comes from")


class ModelPart(FinitePart):
    """One model as it measures."""

    model: str = Field(description="its name")
    names: tuple[str, ...] = Field(description="order of values and covariance")
    values: Vector = Field(description="of the parameters")
    covariance: Matrix = Field(description="of the parameters")
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

    weight: Annotated[float, Field(ge=0, le=1)] = Field(description="of the model in the average")
    with_parameters: Matrix | None = Field(
        None, description="by how much one unit of each shared error moved each parameter"
    )


class ByOneModel(ModelPart):
    """All that measuring by one model needs."""

    stated: Stated = Field(description="what the manifest states of a reading")
    reading: Reading = Field(description="errors of a reading, as the rows bear them out")
    calibrated_depth_mm: tuple[Positive, Positive] = Field(
        description="ends of the depths that the calibration covers"
    )
    shared: Shared | None = Field(None, description="errors that readings share with the rows")
    shared_by_rows: SharedByRows | None = Field(
        None, description="errors that rows alone have in common"
    )

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

    cameras: dict[Literal["c1", "c2"], MeasuringCamera] = Field(
        description="for readings in pixels"
    )


class Measurement(ByOneModel):
    """All that measuring needs: by the rows, of the selected model; by the adjustment."""

    average: tuple[AveragePart, ...] = Field(
        (), exclude_if=not_, description="all fitted models with their weights"
    )
    adjustment: AdjustedMeasurement | None = Field(
        None, description="the instrument by the adjustment"
    )

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
    if np.any(np.diagonal(covariance) < 0):
        return False
    correlation = unit_diagonal(covariance)[1]
    symmetric = np.abs(correlation - correlation.T).max(initial=0.0) <= SYMMETRY
    return bool(symmetric and np.linalg.eigvalsh(correlation).min(initial=0.0) >= -SYMMETRY)
