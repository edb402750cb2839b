"""calibration.json as far as it is read: sections that hold nothing they could not truly say."""

from __future__ import annotations

from typing import Annotated, Literal, Self, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from calib.core.arrays import FloatArray
from calib.geometry.camera import Camera
from calib.geometry.parameters import NAMES
from calib.uncertainty.measurement import ParameterKnowledge, Spread

SYMMETRY = 1e-9
"""Asymmetry of a correlation that is rounding: the file gives twelve digits."""

SUM_OF_WEIGHTS = 1e-6
"""Difference of a sum of weights from 1 that is rounding."""

LENS_COEFFICIENTS = (0, 4, 5, 8, 12, 14)
"""Numbers of coefficients that OpenCV's lens model can have."""

NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
Size = Annotated[int, Field(gt=0)]


class Section(BaseModel):
    """Part of the document; what it does not know of is ignored."""

    model_config = ConfigDict(frozen=True, strict=True, extra="ignore", allow_inf_nan=False)


class SpreadSection(Section):
    """Spread of a reading."""

    normal: NotNegative
    width: NotNegative

    def spread(self) -> Spread:
        """Return it as the instrument has it."""
        return Spread(normal=self.normal, width=self.width)


class Reading(Section):
    """Errors of a reading."""

    x1c: SpreadSection
    y1c: SpreadSection
    alpha2_rad: SpreadSection
    gaze_residual_rad: SpreadSection


class SharedSection(Section):
    """Errors that readings have in common with the rows."""

    names: tuple[str, ...]
    factor: tuple[tuple[float, ...], ...]
    with_parameters: tuple[tuple[float, ...], ...]
    sources: tuple[str, ...] | None = None


class SharedByRows(Section):
    """Errors that the rows alone have in common."""

    with_parameters: tuple[tuple[float, ...], ...]
    sources: tuple[str, ...]


class Stated(Section):
    """Uncertainties that the manifest states."""

    u_x1c: NotNegative
    encoder_step_rad: NotNegative
    u_alpha2_rad: NotNegative


class Parameters(Section):
    """Parameters of one model with their covariance."""

    model: str
    names: tuple[str, ...]
    values: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    noise_factor: Positive
    factor95: Positive

    @model_validator(mode="after")
    def _are_parameters(self) -> Self:
        size = len(self.names)
        if len(set(self.names)) != size or not set(self.names) <= set(NAMES):
            raise ValueError("names are not parameters, each once")
        shapes = {len(self.values), len(self.covariance), *(len(row) for row in self.covariance)}
        if shapes != {size}:
            raise ValueError("names, values and covariance do not belong together")
        if not _is_covariance(np.array(self.covariance)):
            raise ValueError("the covariance is not symmetric, or has a negative variance")
        return self

    def knowledge(self) -> ParameterKnowledge:
        """Return them as the instrument has them."""
        return ParameterKnowledge(
            names=self.names,
            values=np.array(self.values),
            covariance=np.array(self.covariance),
            degrees_of_freedom=None,
            evaluation=("A",) * len(self.names),
        )


class Share(Parameters):
    """One model in the average."""

    weight: Annotated[float, Field(ge=0, le=1)]
    with_parameters: tuple[tuple[float, ...], ...] | None = None


Row: TypeAlias = tuple[float, float, float]


class CameraSection(Section):
    """Intrinsics of one camera."""

    matrix: tuple[Row, Row, Row]
    distortion: tuple[float, ...]
    image_size: tuple[Size, Size]

    @model_validator(mode="after")
    def _is_a_pinhole(self) -> CameraSection:
        if len(self.distortion) not in LENS_COEFFICIENTS:
            raise ValueError(f"{len(self.distortion)} lens coefficients fit no model")
        (fx, skew, _), (zero, fy, _), last = self.matrix
        if min(fx, fy) <= 0 or (skew, zero, *last) != (0, 0, 0, 0, 1):
            raise ValueError("the matrix is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
        return self

    def camera(self) -> Camera:
        """Return the camera."""
        return Camera(np.array(self.matrix), np.array(self.distortion), self.image_size)


class OneInstrument(Parameters):
    """All that measuring with one instrument needs."""

    reading: Reading
    stated: Stated
    calibrated_depth_mm: tuple[Positive, Positive]
    shared: SharedSection | None = None
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


class AdjustedInstrument(OneInstrument):
    """The instrument by the adjustment, with its cameras."""

    cameras: dict[str, CameraSection]


class Measurement(OneInstrument):
    """All that measuring needs."""

    average: tuple[Share, ...] = ()
    adjustment: AdjustedInstrument | None = None

    @model_validator(mode="after")
    def _shares_belong_to_it(self) -> Measurement:
        if self.average and abs(sum(share.weight for share in self.average) - 1) > SUM_OF_WEIGHTS:
            raise ValueError("the models' weights do not add up to 1")
        for share in self.average:
            links = share.with_parameters or ((),) * len(share.names)
            if len(links) != len(share.names) or {len(row) for row in links} != {self.loads}:
                raise ValueError(f"shared errors and parameters of {share.model} do not match")
        return self


def _is_covariance(matrix: FloatArray) -> bool:
    diagonal = np.diag(matrix)
    if np.any(diagonal < 0):
        return False
    unit = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    correlation = matrix / np.outer(unit, unit)
    symmetric = np.abs(correlation - correlation.T).max(initial=0.0) <= SYMMETRY
    return bool(symmetric and np.linalg.eigvalsh(correlation).min(initial=0.0) >= -SYMMETRY)


class GateSection(Section):
    """A check of the result."""

    name: str
    passed: bool
    detail: str = ""


TransformRow = Annotated[tuple[float, ...], Field(min_length=4, max_length=4)]


class Stereo(Section):
    """How the cameras stand."""

    transform_12: Annotated[tuple[TransformRow, ...], Field(min_length=4, max_length=4)]


class RigSection(Section):
    """Which rig was calibrated."""

    serial: str | None = None


class CameraFile(Section):
    """The document, as far as its cameras are read."""

    format: Literal[1]
    gates: tuple[GateSection, ...] = ()
    intrinsics: dict[str, CameraSection]
    stereo: Stereo | None = None


class File(Section):
    """The document, as far as measuring reads it."""

    format: Literal[1]
    gates: tuple[GateSection, ...] = ()
    rig: RigSection = RigSection()
    method: Literal["rows", "adjustment"] = "rows"
    measurement: Measurement
    intrinsics: dict[str, CameraSection] = {}
