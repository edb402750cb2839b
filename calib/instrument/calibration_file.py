"""calibration.json read back: nothing is believed that the file could not say truly."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from pydantic import ValidationError

from calib.core.arrays import FloatArray
from calib.core.errors import InputError
from calib.core.gate import Gate
from calib.core.limited import TooLargeError, read_limited
from calib.core.seal import is_edited
from calib.document.cameras import CameraMatrix, MeasuringCamera
from calib.document.findings import GatePart
from calib.document.measurement import AveragePart, ByOneModel, ModelPart
from calib.document.measurement import Spread as SpreadPart
from calib.document.part import FinitePart
from calib.document.reading import CameraFile, MeasuringFile
from calib.geometry.camera import Camera
from calib.rows.common_errors import CommonErrors
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
    serial
        Serial number of the rig; None if the dataset does not state it.
    by
        The instruments by the rows and by the adjustment, "rows" and "adjustment", where there are
        both; this is one of them.
    """

    instrument: Instrument
    setup: Setup
    noise_factor: float
    calibrated_mm: tuple[float, float]
    factor95: float
    shares: tuple[ModelShare, ...] = ()
    failed_gates: tuple[Gate, ...] = ()
    serial: str | None = None
    by: Mapping[str, Measuring] = field(default_factory=dict)


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
    return read_whole(path, allow_edited=allow_edited)[0]


def read_whole(path: Path, *, allow_edited: bool = False) -> tuple[Measuring, dict[str, Any]]:
    """Return the instrument of a calibration.json, and the document, of the same bytes.

    The document is checked as far as the instrument goes. See `read_calibration` for errors.
    """
    file, document = _read(path, MeasuringFile, "measurement", allow_edited=allow_edited)
    return _measuring(file), document


@dataclass(frozen=True)
class Cameras:
    """The cameras of a calibration and how they stand.

    Parameters
    ----------
    cameras
        By "c1" and "c2", as far as they are known.
    transform_12
        Pose of C2 in C1's frame at the yaw of the stereo pairs, shape (4, 4), mm; None if the
        dataset had no pairs.
    failed_gates
        Checks of the calibration that failed.
    """

    cameras: Mapping[str, Camera]
    transform_12: FloatArray | None
    failed_gates: tuple[Gate, ...]


def read_cameras(path: Path, *, allow_edited: bool = False) -> Cameras:
    """Return the cameras of a calibration.json; see `read_calibration` for errors."""
    file, _ = _read(path, CameraFile, "intrinsics", allow_edited=allow_edited)
    return Cameras(
        cameras={name: _camera(camera) for name, camera in sorted(file.intrinsics.items())},
        transform_12=None if file.stereo is None else np.array(file.stereo.transform_12),
        failed_gates=_failed(file.gates),
    )


_Model = TypeVar("_Model", bound=FinitePart)

_LACKING = {
    "measurement": (
        "holds no gaze calibration",
        "calibrate a dataset with gaze rows; see the gates in its report",
    ),
    "intrinsics": (
        "holds no cameras",
        "calibrate a dataset with [cameras.c1]",
    ),
}


def _read(
    path: Path, model: type[_Model], needed: str, *, allow_edited: bool
) -> tuple[_Model, dict[str, Any]]:
    """Return a calibration.json as far as `model` has it, and the whole document."""
    data = _bytes(path)
    text = _text(path, data)
    document = _document(path, text)
    found = document.get("format") if isinstance(document, dict) else None
    if type(found) is not int or found != FORMAT:
        raise _bad(path, f"format {found!r} is not known", f"format {FORMAT} is; calibrate again")
    if needed not in document:
        raise _bad(path, *_LACKING[needed])
    try:
        file = model.model_validate_json(text, extra="ignore")
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise _bad(
            path, f"{where}: {first['msg']}", "the file is damaged; calibrate again"
        ) from None
    refuse_broken(path, data, edited=allow_edited)
    if is_edited(document) and not allow_edited:
        remedy = "calibrate again, or use it as it is with --allow-edited"
        raise _bad(path, "was edited after the run that wrote it", remedy)
    return file, document


def _failed(gates: Sequence[GatePart]) -> tuple[Gate, ...]:
    return tuple(Gate(g.name, passed=False, detail=g.detail) for g in gates if not g.passed)


def _measuring(file: MeasuringFile) -> Measuring:
    """Return the instrument of record, with the other one."""
    m = file.measurement
    rows = _one(file, m, file.intrinsics)
    reading = rows.instrument.reading
    errors = rows.setup.shared.error_names
    rows = replace(rows, shares=tuple(_share(share, reading, errors) for share in m.average))
    if m.adjustment is None:
        return rows
    adjusted = _one(file, m.adjustment, m.adjustment.cameras)
    by = {"rows": rows, "adjustment": adjusted}
    return replace(by[file.method], by=by)


def _one(
    file: MeasuringFile, m: ByOneModel, intrinsics: Mapping[Literal["c1", "c2"], MeasuringCamera]
) -> Measuring:
    """Return one instrument of a file."""
    reading = ReadingSpread(
        x1c=_spread(m.reading.x1c),
        y1c=_spread(m.reading.y1c),
        alpha2_rad=_spread(m.reading.alpha2_rad),
        gaze_residual_rad=_spread(m.reading.gaze_residual_rad),
    )
    cameras = {str(name): _camera(camera) for name, camera in intrinsics.items()}
    settings = RowSettings(
        u_x1c=m.stated.u_x1c,
        u_z_mm=0.0,
        u_z_rel=0.0,
        encoder_step_rad=m.stated.encoder_step_rad,
        u_alpha2_rad=m.stated.u_alpha2_rad,
    )
    shared = CommonErrors()
    if m.shared is not None:
        factor = np.array(m.shared.factor)
        shared = CommonErrors(
            m.shared.names, factor, m.shared.sources or (UNNAMED,) * factor.shape[1]
        )
    return Measuring(
        instrument=Instrument(_knowledge(m), reading, _errors(m, shared.error_names)),
        setup=Setup(settings, CameraSet(cameras.get("c1"), cameras.get("c2")), shared),
        noise_factor=m.noise_factor,
        calibrated_mm=m.calibrated_depth_mm,
        factor95=m.factor95,
        failed_gates=_failed(file.gates),
        serial=file.rig.serial,
    )


def _knowledge(m: ModelPart) -> ParameterKnowledge:
    return ParameterKnowledge(
        names=m.names,
        values=np.array(m.values),
        covariance=np.array(m.covariance),
        degrees_of_freedom=None,
        evaluation=("A",) * len(m.names),
    )


def _spread(spread: SpreadPart) -> Spread:
    return Spread(normal=spread.normal, width=spread.width)


def _camera(camera: CameraMatrix) -> Camera:
    lens = np.array(camera.distortion)
    projection = camera.projection or "perspective"
    return Camera(np.array(camera.matrix), lens, camera.image_size, projection)


def _errors(m: ByOneModel, of_readings: tuple[str, ...]) -> SharedErrors | None:
    """Return the shared errors: those that readings have too, then those of rows alone."""
    links = np.zeros((len(m.names), 0)) if m.shared is None else np.array(m.shared.with_parameters)
    if m.shared_by_rows is None:
        return None if m.shared is None else SharedErrors(of_readings, links)
    alone = m.shared_by_rows.sources
    links = np.hstack([links, np.array(m.shared_by_rows.with_parameters)])
    return SharedErrors((*of_readings, *alone), links, of_rows_alone=len(alone))


def _share(share: AveragePart, reading: ReadingSpread, errors: tuple[str, ...]) -> ModelShare:
    """Return a model's share; `reading` is that of the selected model, as it stands for all."""
    common = None
    if share.with_parameters is not None:
        common = SharedErrors(errors, np.array(share.with_parameters))
    return ModelShare(
        model=share.model,
        weight=share.weight,
        instrument=Instrument(_knowledge(share), reading, common),
        noise_factor=share.noise_factor,
        factor95=share.factor95,
    )


def _bad(path: Path, what: str, remedy: str) -> InputError:
    return InputError.single(where=str(path), what=what, remedy=remedy)


NOT_A_CALIBRATION = "give the calibration.json of a finished run"


def _bytes(path: Path) -> bytes:
    try:
        return read_limited(path, FILE_LIMIT_BYTES)
    except TooLargeError:
        raise _bad(path, "is too large to be a calibration", NOT_A_CALIBRATION) from None
    except OSError as error:
        raise _bad(path, f"cannot be read ({error.strerror})", NOT_A_CALIBRATION) from None


def _text(path: Path, data: bytes) -> str:
    try:
        return data.decode("utf-8")
    except ValueError:
        raise _bad(path, "is no text in UTF-8", NOT_A_CALIBRATION) from None


def _document(path: Path, text: str) -> Any:
    try:
        return json.loads(text, object_pairs_hook=_each_key_once)
    except (ValueError, RecursionError) as error:
        raise _bad(path, f"is no JSON ({error})", NOT_A_CALIBRATION) from None
    except MemoryError:
        raise _bad(path, "takes more memory than there is", NOT_A_CALIBRATION) from None


def _each_key_once(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) != len(pairs):
        raise ValueError("a key occurs twice")
    return document
