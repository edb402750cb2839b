"""calibration.json read back: nothing is believed that the file could not say truly."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from calib.core.arrays import FloatArray
from calib.core.errors import InputError
from calib.core.gate import Gate
from calib.core.seal import is_edited
from calib.geometry.camera import Camera
from calib.geometry.parameters import NAMES
from calib.rows.common_errors import Shared
from calib.rows.from_table import CameraSet, RowSettings, Setup
from calib.stages.manifest import refuse_broken
from calib.uncertainty.measurement import (
    Instrument,
    ModelShare,
    ParameterKnowledge,
    ReadingSpread,
    SharedErrors,
    Spread,
)

FORMAT = 1
"""Of calibration.json; it changes only if old files can no longer be read."""

FILE_LIMIT_BYTES = 200_000_000
"""A calibration of 100,000 rows takes a tenth of it."""

UNNAMED = "intrinsics and pose of the cameras"
"""Source of all shared errors in a file that names none."""

SYMMETRY = 1e-9
"""Asymmetry of a correlation that is rounding: the file gives twelve digits."""

SUM_OF_WEIGHTS = 1e-6
"""Difference of a sum of weights from 1 that is rounding."""

LENS_COEFFICIENTS = (0, 4, 5, 8, 12, 14)
"""Numbers of coefficients that OpenCV's lens model can have."""

NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
Size = Annotated[int, Field(gt=0)]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="ignore", allow_inf_nan=False)


class _Spread(_Section):
    normal: NotNegative
    width: NotNegative

    def spread(self) -> Spread:
        return Spread(normal=self.normal, width=self.width)


class _Reading(_Section):
    x1c: _Spread
    y1c: _Spread
    alpha2_rad: _Spread
    gaze_residual_rad: _Spread


class _Shared(_Section):
    names: tuple[str, ...]
    factor: tuple[tuple[float, ...], ...]
    with_parameters: tuple[tuple[float, ...], ...]
    sources: tuple[str, ...] | None = None


class _SharedByRows(_Section):
    with_parameters: tuple[tuple[float, ...], ...]
    sources: tuple[str, ...]


class _Stated(_Section):
    u_x1c: NotNegative
    encoder_step_rad: NotNegative
    u_alpha2_rad: NotNegative


class _Parameters(_Section):
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
        return ParameterKnowledge(
            names=self.names,
            values=np.array(self.values),
            covariance=np.array(self.covariance),
            degrees_of_freedom=None,
            evaluation=("A",) * len(self.names),
        )


class _Share(_Parameters):
    weight: Annotated[float, Field(ge=0, le=1)]
    with_parameters: tuple[tuple[float, ...], ...] | None = None


class _Measurement(_Parameters):
    reading: _Reading
    stated: _Stated
    calibrated_depth_mm: tuple[Positive, Positive]
    shared: _Shared | None = None
    shared_by_rows: _SharedByRows | None = None
    average: tuple[_Share, ...] = ()

    @model_validator(mode="after")
    def _belongs_together(self) -> _Measurement:
        size, loads = len(self.names), 0
        if self.calibrated_depth_mm[0] > self.calibrated_depth_mm[1]:
            raise ValueError("the calibrated depths end before they begin")
        if self.shared is not None:
            errors = {len(row) for row in (*self.shared.factor, *self.shared.with_parameters)}
            counts = len(self.shared.factor), len(self.shared.with_parameters)
            if len(errors) != 1 or counts != (len(self.shared.names), size):
                raise ValueError("names and arrays of the shared errors do not belong together")
            if self.shared.sources is not None and {len(self.shared.sources)} != errors:
                raise ValueError("sources of the shared errors do not belong to them")
            loads = errors.pop()
        if self.shared_by_rows is not None:
            rows = self.shared_by_rows.with_parameters
            errors = {len(self.shared_by_rows.sources)}
            if len(rows) != size or {len(row) for row in rows} != errors:
                raise ValueError("errors that rows share and parameters do not belong together")
        if self.average and abs(sum(share.weight for share in self.average) - 1) > SUM_OF_WEIGHTS:
            raise ValueError("the models' weights do not add up to 1")
        for share in self.average:
            links = share.with_parameters or ((),) * len(share.names)
            if len(links) != len(share.names) or {len(row) for row in links} != {loads}:
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


_Row: TypeAlias = tuple[float, float, float]


class _Camera(_Section):
    matrix: tuple[_Row, _Row, _Row]
    distortion: tuple[float, ...]
    image_size: tuple[Size, Size]

    @model_validator(mode="after")
    def _is_a_pinhole(self) -> _Camera:
        if len(self.distortion) not in LENS_COEFFICIENTS:
            raise ValueError(f"{len(self.distortion)} lens coefficients fit no model")
        (fx, skew, _), (zero, fy, _), last = self.matrix
        if min(fx, fy) <= 0 or (skew, zero, *last) != (0, 0, 0, 0, 1):
            raise ValueError("the matrix is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
        return self

    def camera(self) -> Camera:
        return Camera(np.array(self.matrix), np.array(self.distortion), self.image_size)


class _Gate(_Section):
    name: str
    passed: bool
    detail: str = ""


class _File(_Section):
    format: Literal[1]
    gates: tuple[_Gate, ...] = ()
    measurement: _Measurement
    intrinsics: dict[str, _Camera] = {}


@dataclass(frozen=True)
class Measuring:
    """An instrument as calibration.json describes it.

    Parameters
    ----------
    instrument
        Parameters, their covariance and the errors of a reading.
    setup
        Cameras for readings in pixels, and the errors that readings share with the calibration.
    noise_factor
        By how much the calibration proved the stated uncertainties of a reading too small.
    calibrated_mm
        Depths that the calibration covers.
    factor95
        Coverage factor of inverse depth.
    shares
        All fitted models, the selected one among them; empty in a file that holds that one alone.
    failed_gates
        Checks of the calibration that failed: the result must not be used.
    """

    instrument: Instrument
    setup: Setup
    noise_factor: float
    calibrated_mm: tuple[float, float]
    factor95: float
    shares: tuple[ModelShare, ...] = ()
    failed_gates: tuple[Gate, ...] = ()


def read_calibration(path: Path, *, allow_edited: bool = False) -> Measuring:
    """Return the instrument of a calibration.json.

    Parameters
    ----------
    allow_edited
        Whether a file that is not what a run wrote is used all the same.

    Raises
    ------
    InputError
        If the file is none, is damaged, has another format or holds no gaze calibration; if it was
        edited, or lies beside files of another run.
    """
    text = _text(path)
    document = _document(path, text)
    found = document.get("format") if isinstance(document, dict) else None
    if type(found) is not int or found != FORMAT:
        raise _bad(path, f"format {found!r} is not known", f"format {FORMAT} is; calibrate again")
    if "measurement" not in document:
        remedy = "calibrate a dataset with gaze rows; see the gates in its report"
        raise _bad(path, "holds no gaze calibration", remedy)
    try:
        file = _File.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise _bad(
            path, f"{where}: {first['msg']}", "the file is damaged; calibrate again"
        ) from None
    refuse_broken(path, edited=allow_edited)
    if is_edited(document) and not allow_edited:
        remedy = "calibrate again, or use it as it is with --allow-edited"
        raise _bad(path, "was edited after the run that wrote it", remedy)
    return _measuring(file)


def _measuring(file: _File) -> Measuring:
    m = file.measurement
    reading = ReadingSpread(
        x1c=m.reading.x1c.spread(),
        y1c=m.reading.y1c.spread(),
        alpha2_rad=m.reading.alpha2_rad.spread(),
        gaze_residual_rad=m.reading.gaze_residual_rad.spread(),
    )
    cameras = {name: camera.camera() for name, camera in file.intrinsics.items()}
    settings = RowSettings(
        u_x1c=m.stated.u_x1c,
        u_z_mm=0.0,
        u_z_rel=0.0,
        encoder_step_rad=m.stated.encoder_step_rad,
        u_alpha2_rad=m.stated.u_alpha2_rad,
    )
    shared = Shared()
    if m.shared is not None:
        factor = np.array(m.shared.factor)
        shared = Shared(m.shared.names, factor, m.shared.sources or (UNNAMED,) * factor.shape[1])
    return Measuring(
        instrument=Instrument(m.knowledge(), reading, _errors(m, shared.error_names)),
        setup=Setup(settings, CameraSet(cameras.get("c1"), cameras.get("c2")), shared),
        noise_factor=m.noise_factor,
        calibrated_mm=m.calibrated_depth_mm,
        factor95=m.factor95,
        shares=tuple(_share(share, reading, shared.error_names) for share in m.average),
        failed_gates=tuple(
            Gate(gate.name, passed=False, detail=gate.detail)
            for gate in file.gates
            if not gate.passed
        ),
    )


def _errors(m: _Measurement, of_readings: tuple[str, ...]) -> SharedErrors | None:
    """Return the shared errors: those that readings have too, then those of rows alone."""
    links = np.zeros((len(m.names), 0)) if m.shared is None else np.array(m.shared.with_parameters)
    if m.shared_by_rows is None:
        return None if m.shared is None else SharedErrors(of_readings, links)
    alone = m.shared_by_rows.sources
    links = np.hstack([links, np.array(m.shared_by_rows.with_parameters)])
    return SharedErrors((*of_readings, *alone), links, of_rows_alone=len(alone))


def _share(share: _Share, reading: ReadingSpread, errors: tuple[str, ...]) -> ModelShare:
    """Return a model's share; `reading` is that of the selected model, as it stands for all."""
    common = None
    if share.with_parameters is not None:
        common = SharedErrors(errors, np.array(share.with_parameters))
    return ModelShare(
        model=share.model,
        weight=share.weight,
        instrument=Instrument(share.knowledge(), reading, common),
        noise_factor=share.noise_factor,
        factor95=share.factor95,
    )


def _bad(path: Path, what: str, remedy: str) -> InputError:
    return InputError.single(where=str(path), what=what, remedy=remedy)


NOT_A_CALIBRATION = "give the calibration.json of a finished run"


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > FILE_LIMIT_BYTES:
            raise _bad(path, "is too large to be a calibration", NOT_A_CALIBRATION)
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise _bad(path, f"cannot be read ({error.strerror})", NOT_A_CALIBRATION) from None
    except ValueError:
        raise _bad(path, "is no text in UTF-8", NOT_A_CALIBRATION) from None


def _document(path: Path, text: str) -> Any:
    try:
        return json.loads(text, object_pairs_hook=_each_key_once)
    except (ValueError, RecursionError) as error:
        raise _bad(path, f"is no JSON ({error})", NOT_A_CALIBRATION) from None


def _each_key_once(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) != len(pairs):
        raise ValueError("a key occurs twice")
    return document
