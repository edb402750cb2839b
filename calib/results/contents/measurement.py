"""calibration.json: all that measuring needs, and what it is then worth."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from calib.document import measurement as document
from calib.document.cameras import MeasuringCamera
from calib.document.depths import AverageDepth, Depth, ValidationRow
from calib.document.part import Matrix, matrix, vector
from calib.instrument.adjusted import Described
from calib.instrument.averaging import ModelAverage
from calib.instrument.calibrated import CalibratedInstrument, DepthTable
from calib.instrument.validation import ValidationResult
from calib.results.calibration import GazeResult
from calib.results.contents.images import CameraName, camera_matrix
from calib.uncertainty.measurement import Instrument, ModelShare, SharedErrors, Spread


def measurement(g: GazeResult) -> tuple[document.Measurement | None, str]:
    """Return all that `calib measure` needs, or None and why nothing can be measured with it.

    None and no reason where there is no instrument by the rows.
    """
    if g.by_rows is None:
        return None, ""
    try:
        return document.Measurement(
            average=() if g.average is None else tuple(map(_share, g.average.shares)),
            adjustment=None if g.by_adjustment is None else _adjusted(g.by_adjustment),
            **_by_one_model(g.by_rows),
        ), ""
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        return None, f"{'.'.join(map(str, first['loc']))}: {first['msg']}"


def _adjusted(found: Described) -> document.AdjustedMeasurement:
    cameras = found.calibrated.setup.cameras
    named: tuple[CameraName, ...] = ("c1", "c2")
    return document.AdjustedMeasurement(
        cameras={
            name: MeasuringCamera(**camera_matrix(camera))
            for name, camera in zip(named, (cameras.c1, cameras.c2), strict=True)
            if camera is not None
        },
        **_by_one_model(found),
    )


def _by_one_model(found: Described) -> dict[str, Any]:
    """Return the keys of `ByOneModel` of an instrument."""
    c: CalibratedInstrument = found.calibrated
    reading, settings = c.instrument.reading, c.setup.settings
    return _model(c.model, c.instrument, c.noise_factor, found.depths.factor95) | {
        "stated": document.Stated(
            u_x1c=reading.x1c.normal / c.noise_factor,
            encoder_step_rad=settings.encoder_step_rad,
            u_alpha2_rad=settings.u_alpha2_rad,
        ),
        "reading": document.Reading(
            x1c=_spread(reading.x1c),
            y1c=_spread(reading.y1c),
            alpha2_rad=_spread(reading.alpha2_rad),
            gaze_residual_rad=_spread(reading.gaze_residual_rad),
        ),
        "calibrated_depth_mm": tuple(map(float, c.calibrated_mm)),
        "shared": _shared(c),
        "shared_by_rows": _shared_by_rows(c.instrument.shared),
    }


def _model(model: str, of: Instrument, noise_factor: float, factor95: float) -> dict[str, Any]:
    """Return the keys of `ModelPart`."""
    return {
        "model": model,
        "names": tuple(of.parameters.names),
        "values": vector(of.parameters.values),
        "covariance": matrix(of.parameters.covariance),
        "noise_factor": float(noise_factor),
        "factor95": float(factor95),
    }


def _share(share: ModelShare) -> document.AveragePart:
    return document.AveragePart(
        weight=share.weight,
        with_parameters=_with_parameters(share.instrument.shared),
        **_model(share.model, share.instrument, share.noise_factor, share.factor95),
    )


def _with_parameters(shared: SharedErrors | None) -> Matrix | None:
    """Return what the errors that readings have too have moved the parameters by; None if none."""
    if shared is None or not shared.of_readings:
        return None
    return matrix(shared.with_parameters[:, : shared.of_readings])


def _spread(spread: Spread) -> document.Spread:
    return document.Spread(normal=spread.normal, width=spread.width)


def _shared(c: CalibratedInstrument) -> document.Shared | None:
    """Return the errors that readings share with the calibration, None without any."""
    shared, errors = c.setup.shared, c.instrument.shared
    if errors is None or not shared.names:
        return None
    return document.Shared(
        names=tuple(shared.names),
        factor=matrix(shared.factor),
        with_parameters=matrix(errors.with_parameters[:, : errors.of_readings]),
        sources=tuple(shared.error_names),
    )


def _shared_by_rows(errors: SharedErrors | None) -> document.SharedByRows | None:
    """Return the errors that calibration rows share and readings do not have, None without any."""
    if errors is None or not errors.of_rows_alone:
        return None
    return document.SharedByRows(
        with_parameters=matrix(errors.with_parameters[:, errors.of_readings :]),
        sources=tuple(errors.names[errors.of_readings :]),
    )


def depths(table: DepthTable) -> tuple[Depth, ...]:
    """Return the depths of the instrument of record."""
    p = table.prediction
    return tuple(
        Depth(
            z_mm=table.depth_mm[i],
            u_mm=p.u_mm[i],
            low95_mm=p.low95_mm[i],
            high95_mm=p.high95_mm[i],
            gum_u_mm=p.gum_u_mm[i],
            gum_valid=bool(p.gum_valid[i]),
            extrapolated=bool(table.extrapolated[i]),
            gum_sources_mm={name: u[i] for name, u in table.sources_mm.items()},
        )
        for i in range(len(table.depth_mm))
    )


def average_depths(average: ModelAverage) -> tuple[AverageDepth, ...]:
    """Return the same depths as all models together measure them."""
    p = average.prediction
    return tuple(
        AverageDepth(
            z_mm=average.depth_mm[i],
            mean_mm=p.z_mm[i],
            u_mm=p.u_mm[i],
            low95_mm=p.low95_mm[i],
            high95_mm=p.high95_mm[i],
        )
        for i in range(len(average.depth_mm))
    )


def validation(v: ValidationResult) -> tuple[ValidationRow, ...]:
    """Return the validation rows as measured."""
    p = v.prediction
    return tuple(
        ValidationRow(
            id=name,
            group=v.groups[i],
            x_mm=v.position_mm[i, 0],
            y_mm=v.position_mm[i, 1],
            z_mm=p.z_mm[i],
            u_mm=p.u_mm[i],
            low95_mm=p.low95_mm[i],
            high95_mm=p.high95_mm[i],
            reference_mm=v.reference_mm[i],
            error_rel=v.errors[0].error_rel[i],
            other_references_error_rel={e.name: e.error_rel[i] for e in v.errors[1:]},
            own_angle_z_mm={model: z[i] for model, z in v.own_depth_mm.items()},
        )
        for i, name in enumerate(v.ids)
    )
