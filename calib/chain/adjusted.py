"""The instrument by the adjustment: what it measures, certified where it is that of record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from calib.chain.images import ImageStages, image_observations
from calib.chain.rows import gaze_setup, validation_setup
from calib.core.gate import Gate
from calib.dataset.contents import Dataset
from calib.dataset.tables import LengthTable
from calib.fit.robust import RobustFit
from calib.images.adjustment.gates import rig_gates
from calib.images.adjustment.result import Adjustment
from calib.instrument.adjusted import (
    ADJUSTMENT,
    AS_ASKED,
    ROWS,
    Choice,
    Described,
    adjust_instrument,
    agreement,
    choose,
)
from calib.instrument.averaging import without_draws
from calib.instrument.calibrated import CalibratedInstrument, tabulate_depths
from calib.instrument.evidence import gather_evidence
from calib.instrument.validation import measure_validation
from calib.results.calibration import GazeResult
from calib.rows.common_errors import CommonErrors
from calib.rows.from_table import Setup, ValidationRows, observe_validation
from calib.rows.observations import Observations
from calib.rows.repeated_readings import observe_gazes
from calib.stages.store import Staged, Store, gather, given, optional, stage

BY = "adjusted "
"""Before the names of stages with cameras and instrument of the adjustment."""


def chosen(
    dataset: Dataset,
    method: str,
    gaze: GazeResult,
    rows: Observations,
    shared: CommonErrors,
    adjustment: Adjustment,
) -> Choice:
    """Return from what the instrument is taken.

    Parameters
    ----------
    method
        What the user asks for.
    shared
        By what `rows` have errors in common.
    """
    agrees = None
    if gaze.calibrated is not None:
        agrees = agreement(
            adjustment,
            rows,
            shared,
            noise_factor=gaze.calibrated.noise_factor,
            outliers=gaze.robust[gaze.calibrated.model].outliers,
        )
    corrected = dataset.manifest.corrections is not None
    return choose(method, adjustment, agrees, corrected=corrected)


def of_record(
    dataset: Dataset,
    method: str,
    rows: Staged[Observations],
    shared: Staged[CommonErrors],
    adjustment: Staged[Adjustment] | None,
) -> Callable[[GazeResult], bool]:
    """Return what tells whether the instrument by the rows is of record, and so is certified."""

    def by_rows(gaze: GazeResult) -> bool:
        if adjustment is None or adjustment.failed is not None:
            return True
        choice = chosen(dataset, method, gaze, rows.value, shared.value, adjustment.value)
        return choice.method != ADJUSTMENT

    return by_rows


def adjustment_gates(
    adjustment: Staged[Adjustment] | None, choice: Choice | None
) -> tuple[Gate, ...]:
    """Return the gates of the adjustment; those of cameras and rig where rows are of record."""
    if adjustment is None or choice is None:
        return ()
    gates = adjustment.value.gates
    return rig_gates(gates) if choice.method == ROWS else gates


def not_used(choice: Choice | None) -> tuple[str, ...]:
    """Return a warning where there is an adjustment that the rule has not taken."""
    if choice is None or choice.method != ROWS or choice.reason == AS_ASKED:
        return ()
    return (f"the adjustment of all pictures is not used: {choice.reason}",)


def with_adjustment(
    dataset: Dataset,
    store: Store,
    images: ImageStages,
    gaze: GazeResult,
    adjustment: Staged[Adjustment],
    choice: Choice,
    *,
    seed: int,
) -> GazeResult:
    """Return the result with the instrument by the adjustment: as that of record where chosen."""
    if gaze.calibrated is None or gaze.depths is None or dataset.gaze is None:
        return replace(gaze, choice=choice)
    run = store.run
    by_rows = Described(gaze.calibrated, gaze.depths, gaze.validation)
    plain = replace(gaze.calibrated, instrument=without_draws(gaze.calibrated.instrument))
    # fmt: off
    calibrated = run(stage(f"{BY}instrument", adjust_instrument,
                           given("instrument by the rows", plain), adjustment))
    changed = _changed(images, calibrated.value)
    validation = _validation(dataset, store, changed)
    depth = gaze.depths.depth_mm
    depths = run(stage(f"{BY}depths", tabulate_depths, calibrated,
                       low_mm=float(depth[0]), high_mm=float(depth[-1]), seed=seed))
    measured = None
    if validation is not None:
        fits: Mapping[str, Staged[RobustFit]] = {}
        measured = run(stage(f"{BY}validation", measure_validation,
                             calibrated, validation, gather(fits), seed=seed))
    # fmt: on
    found = None
    if measured is not None and gaze.validation is not None:
        found = replace(measured.value, own_depth_mm=gaze.validation.own_depth_mm)
    described = Described(calibrated.value, depths.value, found)
    if choice.method != ADJUSTMENT:
        return replace(gaze, choice=choice, beside=described)
    seen = image_observations(dataset, dataset.gaze, store, changed, by=BY)
    setup = given("setup", gaze_setup(dataset, changed))
    rows = run(
        stage(
            f"{BY}observations", observe_gazes, given("gaze", dataset.gaze), setup, optional(seen)
        )
    )
    evidence = run(certified(
        BY, dataset, calibrated, rows, optional(validation), optional(measured), seed=seed,
    ))  # fmt: skip
    return replace(
        gaze,
        choice=choice,
        beside=by_rows,
        calibrated=described.calibrated,
        depths=described.depths,
        validation=described.validation,
        evidence=evidence.get(),
        not_certified=evidence.failed,
    )


def certified(
    by: str,
    dataset: Dataset,
    calibrated: Staged[CalibratedInstrument],
    rows: Staged[Observations],
    validation: Staged[Any],
    measured: Staged[Any],
    *,
    seed: int,
) -> Any:
    """Return the stage that finds what is certified of an instrument."""
    stated, checked = dataset.manifest.certificate, dataset.manifest.validation
    lengths: Staged[LengthTable] | None = None
    if dataset.lengths is not None:
        lengths = given("lengths", dataset.lengths)
    return stage(
        f"{by}certified depths", gather_evidence,
        calibrated, rows, validation, measured, optional(lengths), seed=seed,
        check_reference=None if checked is None else checked.reference,
        depth_rel=None if stated.tolerance is None else stated.tolerance.depth_rel,
        rule=stated.decision_rule,
    )  # fmt: skip


def _changed(images: ImageStages, calibrated: CalibratedInstrument) -> ImageStages:
    """Return the image stages with cameras and shared errors of the adjustment."""
    setup: Setup = calibrated.setup
    shared = given("adjusted shared errors", setup.shared)
    return replace(images, cameras=setup.cameras, shared=shared)


def _validation(
    dataset: Dataset, store: Store, images: ImageStages
) -> Staged[ValidationRows] | None:
    table, stated = dataset.validation, dataset.manifest.validation
    if table is None:
        return None
    setup = given("setup", validation_setup(dataset, images))
    seen = image_observations(dataset, table, store, images, by=BY)
    rows = store.run(stage(
        f"{BY}validation rows", observe_validation,
        given("validation", table), setup, optional(seen),
        own_origin=stated is not None and stated.origin is not None,
    ))  # fmt: skip
    return rows if rows.failed is None else None
