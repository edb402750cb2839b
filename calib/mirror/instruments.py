"""The calibrated instrument and what it measures, back from the mirror."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.arrays import FloatArray
from calib.geometry.mirror import POINT, mirror_matrix, mirror_readings, signed, signs
from calib.geometry.parameters import GAZED_BASELINE
from calib.instrument.averaging import ModelAverage
from calib.instrument.calibrated import CalibratedInstrument
from calib.instrument.validation import ValidationResult
from calib.mirror.problem import Mirror
from calib.rows.from_table import Setup
from calib.uncertainty.budget import Budget, BudgetRow, CorrelationRow
from calib.uncertainty.certified import CertifiedDepth
from calib.uncertainty.depth import DepthUncertainty, PositionUncertainty
from calib.uncertainty.evidence import Evidence
from calib.uncertainty.measurement import READING_NAMES, Instrument, ParameterKnowledge

_POINT = np.array(POINT)
_ODD_READINGS = ("x1c", "alpha2", "gaze residual")
_READING = "alpha2"


def mirror_calibrated(
    calibrated: CalibratedInstrument, mirror: Mirror, setup: Setup
) -> CalibratedInstrument:
    """Return the calibrated instrument with the rig's own set-up."""
    instrument = mirror_instrument(calibrated.instrument, mirror)
    return replace(calibrated, instrument=instrument, setup=setup)


def mirror_average(average: ModelAverage, mirror: Mirror) -> ModelAverage:
    """Return the average over models; the depths that it states are the same in a mirror."""
    shares = tuple(
        replace(share, instrument=mirror_instrument(share.instrument, mirror))
        for share in average.shares
    )
    return replace(average, shares=shares)


def mirror_instrument(instrument: Instrument, mirror: Mirror) -> Instrument:
    """Return an instrument."""
    sign, shared = signs(instrument.parameters.names), instrument.shared
    if shared is not None:
        columns = np.outer(sign, mirror.columns(len(shared.names)))
        shared = replace(
            shared,
            with_parameters=signed(shared.with_parameters, columns),
            own_draws=_draws(shared.own_draws, sign),
        )
    return replace(
        instrument,
        parameters=_parameters(instrument.parameters),
        shared=shared,
        mean_gaze_rad=_reading(instrument.mean_gaze_rad),
    )


def _parameters(known: ParameterKnowledge) -> ParameterKnowledge:
    sign = signs(known.names)
    return replace(
        known,
        values=signed(known.values, sign),
        covariance=mirror_matrix(known.covariance, sign),
        draws=_draws(known.draws, sign),
    )


def _draws(draws: FloatArray | None, sign: FloatArray) -> FloatArray | None:
    return None if draws is None else signed(draws, sign)


def mirror_measured(measured: ValidationResult) -> ValidationResult:
    """Return what was measured on the validation rows."""
    return replace(measured, position_mm=signed(measured.position_mm, _POINT))


def mirror_evidence(evidence: Evidence) -> Evidence:
    """Return what is stated of the accuracy; checks and lengths are the same in a mirror."""
    return replace(evidence, depths=tuple(_certified(depth) for depth in evidence.depths))


def _certified(certified: CertifiedDepth) -> CertifiedDepth:
    return replace(
        certified, result=_depth(certified.result), position=_position(certified.position)
    )


def _depth(result: DepthUncertainty) -> DepthUncertainty:
    return replace(
        result,
        x1c=-result.x1c + 0.0,
        alpha2_rad=_reading(result.alpha2_rad),
        budget=mirror_budget(result.budget),
    )


def _reading(alpha2: float) -> float:
    return float(mirror_readings(np.array([alpha2]))[0])


def _position(found: PositionUncertainty) -> PositionUncertainty:
    return replace(
        found,
        position_mm=signed(found.position_mm, _POINT),
        covariance_mm2=mirror_matrix(found.covariance_mm2, _POINT),
        directions=signed(found.directions, _POINT[:, None]),
    )


def mirror_budget(budget: Budget) -> Budget:
    """Return the budget of a depth: what each input contributes is the same in a mirror."""
    return replace(
        budget,
        rows=tuple(_budget_row(row) for row in budget.rows),
        correlations=tuple(_pair(pair) for pair in budget.correlations),
    )


def _budget_row(row: BudgetRow) -> BudgetRow:
    given, sign = row.input, _input_sign(row.input.name)
    estimate = sign * given.estimate + 0.0
    if _quantity(given.name) == _READING:
        estimate = _reading(given.estimate)
    return replace(
        row,
        input=replace(given, estimate=estimate, sensitivity=sign * given.sensitivity + 0.0),
    )


def _pair(pair: CorrelationRow) -> CorrelationRow:
    sign = _input_sign(pair.first) * _input_sign(pair.second)
    return replace(pair, correlation=sign * pair.correlation)


def _quantity(name: str) -> str:
    """Return the observed quantity of a reading's error ("alpha2, resolution"), else the name."""
    head = name.partition(",")[0]
    return head if head in READING_NAMES else name


def _input_sign(name: str) -> float:
    if _quantity(name) in _ODD_READINGS or name == GAZED_BASELINE:
        return -1.0
    return float(signs([name])[0])
