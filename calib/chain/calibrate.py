"""The whole chain: stages in their order, then the outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.chain.adjusted import (
    adjustment_gates,
    certified,
    chosen,
    not_used,
    of_record,
    with_adjustment,
)
from calib.chain.adjustment import adjustment_stage
from calib.chain.images import ImageStages, image_observations, image_stages
from calib.chain.outputs import write_outputs
from calib.chain.rows import gaze_rows, gaze_setup, validation_setup
from calib.checks.encoder_direction import check_encoder_direction
from calib.checks.prior_conflict import prior_warnings
from calib.checks.references import disagreements
from calib.checks.returns import returns_gates
from calib.checks.stereo_pose import pose_warnings
from calib.checks.verdict import all_gates, all_warnings
from calib.core.errors import InputError
from calib.dataset.contents import Dataset
from calib.dataset.given_lens import given_lens_covariance
from calib.dataset.tables import LengthTable
from calib.diagnosis.correction import correct_rows
from calib.diagnosis.findings import Attempt
from calib.diagnosis.independent import diagnose_references
from calib.diagnosis.second import diagnose
from calib.diagnosis.session import row_history
from calib.fit.compare import compare_models
from calib.fit.convex import fit_convex
from calib.fit.group_check import check_groups
from calib.fit.identifiability import identifiability
from calib.fit.linear import fit_linear
from calib.fit.posterior import Posterior, sample_posterior
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_model
from calib.fit.scale import scaled_defaults
from calib.geometry.parameters import MODELS
from calib.instrument.adjusted import BY_RULE, refuse_missing
from calib.instrument.averaging import build_average
from calib.instrument.calibrated import build_instrument, tabulate_depths
from calib.instrument.validation import measure_validation
from calib.mirror.gaze import mirror_gaze
from calib.mirror.problem import Mirror, mirror_priors
from calib.results.calibration import Calibration, GazeResult
from calib.results.published import contradictions
from calib.rows.from_table import ValidationRows, observe_validation, row_priors
from calib.rows.observations import Observations
from calib.rows.repeated_readings import repetition_warning
from calib.rows.sketch import sketch
from calib.stages.manifest import run_fingerprint
from calib.stages.owner import claim
from calib.stages.store import Staged, Store, gather, given, optional, stage

LONG_CHAINS = 1000
"""Rows from which on a chain takes longer than the start of the process that computes it."""


@dataclass(frozen=True)
class Options:
    """What the user may choose of a run.

    Parameters
    ----------
    seed
        Of all random numbers.
    depths_mm
        Least and greatest depth of the uncertainty table; None for those of the rows.
    method
        From what the instrument is taken; by default from the adjustment of all pictures where
        there is one that may be used.
    """

    seed: int = 0
    depths_mm: tuple[float, float] | None = None
    method: str = BY_RULE


@dataclass(frozen=True)
class Run:
    """What a run has done: the result, the stages that ran and were reused, the files."""

    calibration: Calibration
    stages_run: tuple[str, ...]
    stages_reused: tuple[str, ...]
    written: tuple[Path, ...]


def calibrate(
    dataset: Dataset,
    out: Path,
    options: Options,
    *,
    announce: Callable[[str], None],
    progress: Callable[[str, int, int], None],
    command: str,
) -> Run:
    """Run the chain on a dataset; results go to `out`.

    Raises
    ------
    InputError, UsageError
        If images of the dataset or the folder cannot be used.
    """
    fingerprint = run_fingerprint(dataset.sha256, vars(options))
    store = Store(out, announce, progress)
    with store.locked():
        claim(out, dataset.owner)
        images = image_stages(dataset, store, options.seed)
        adjustment = adjustment_stage(dataset, store, images)
        failures = images.failures()
        refuse_missing(options.method, None if adjustment is None else adjustment.get())
        gaze, choice = None, None
        if dataset.gaze is not None:
            rows = gaze_rows(dataset, dataset.gaze, store, images)
            by_rows = of_record(dataset, options.method, rows, images.shared, adjustment)
            if rows.failed is not None:
                failures["gaze rows"] = rows.failed
            elif dataset.manifest.rig.is_left:
                mirror = Mirror.of(images.shared.value)
                mirrored = given("mirrored rows", mirror.rows(rows.value))
                setup = gaze_setup(dataset, images)
                gaze = _gaze_chain(dataset, options, store, images, mirrored, by_rows, mirror)
                own = rows.value if gaze.correction is None else mirror.rows(gaze.rows)
                gaze = mirror_gaze(gaze, mirror, rows=own, setup=setup)
            else:
                gaze = _gaze_chain(dataset, options, store, images, rows, by_rows)
        if gaze is not None and adjustment is not None and adjustment.failed is None:
            choice = chosen(
                dataset, options.method, gaze, rows.value, images.shared.value, adjustment.value
            )
            gaze = with_adjustment(
                dataset, store, images, gaze, adjustment, choice, seed=options.seed
            )
        result = images.result()
        calibration = Calibration(
            name=dataset.manifest.name,
            title=dataset.manifest.title,
            sha256=dataset.sha256,
            rig=dataset.manifest.rig,
            seed=options.seed,
            cameras=dataset.cameras,
            camera_covariances={n: given_lens_covariance(dataset, n) for n in dataset.cameras},
            images=result,
            gaze=gaze,
            adjustment=None if adjustment is None else adjustment.get(),
            not_adjusted=None if adjustment is None else adjustment.failed,
            gates=(
                *all_gates(result, gaze, failures),
                *adjustment_gates(adjustment, choice),
                *returns_gates(dataset),
            ),
            warnings=(
                *dataset.warnings,
                *_combined(dataset, gaze),
                *all_warnings(result, gaze),
                *(() if gaze is None else prior_warnings(gaze, row_priors(dataset))),
                *not_used(choice),
                *pose_warnings(dataset, result.stereo, gaze),
                *contradictions(
                    result, {n: (p.mean, p.std) for n, p in dataset.manifest.published.items()}
                ),
            ),
            rows=None if dataset.gaze is None else sketch(dataset.gaze, result.corners),
            disagreements=() if gaze is None else disagreements(gaze),
        )
        written = write_outputs(
            calibration, dataset, store, fingerprint=fingerprint, command=command
        )
    return Run(calibration, tuple(store.durations), tuple(store.reused), written)


def _combined(dataset: Dataset, gaze: GazeResult | None) -> tuple[str, ...]:
    """Return a warning if gazes were repeated."""
    if dataset.gaze is None or gaze is None:
        return ()
    told = repetition_warning(dataset.gaze, gaze.rows)
    return () if told is None else (told,)


def _gaze_chain(
    dataset: Dataset,
    options: Options,
    store: Store,
    images: ImageStages,
    rows: Staged[Observations],
    by_rows: Callable[[GazeResult], bool],
    mirror: Mirror | None = None,
) -> GazeResult:
    """From gaze rows to the calibrated instrument and what it measures.

    `by_rows` tells whether the instrument that they give is that of record, which is certified.
    With a mirror, all of it is that of the rig's mirror image, whose rows these then are.
    """
    run, is_left = store.run, mirror is not None
    defaults = scaled_defaults(rows.value)
    known = Priors(defaults | row_priors(dataset), images.measured())
    priors = given("priors", mirror_priors(known) if is_left else known)
    rows, correction = _corrected(dataset, store, rows, priors, is_left=is_left)
    # fmt: off
    encoder_direction = run(stage("encoder direction", check_encoder_direction, rows,
                                  is_left=is_left))
    linear = run(stage("base/linear", fit_linear, rows))
    convex = run(stage("base/convex", fit_convex, rows))
    robust = {model: run(stage(f"{model}/robust", fit_model, rows, priors, model=model))
              for model in MODELS}
    # fmt: on
    posterior = store.run_all(
        {
            model: stage(
                f"{model}/posterior", sample_posterior, rows, fit, priors, seed=options.seed
            )
            for model, fit in robust.items()
            if fit.failed is None
        },
        side_by_side=len(rows.value) >= LONG_CHAINS,
    )
    every = {"base/linear": linear, "base/convex": convex}
    every |= {f"{name}/robust": fit for name, fit in robust.items()}
    every |= {f"{name}/posterior": chain for name, chain in posterior.items()}
    result = GazeResult(
        rows=rows.value,
        encoder_direction=encoder_direction.value,
        linear=linear.get(),
        convex=convex.get(),
        robust={name: robust[name].value for name, p in posterior.items() if p.failed is None},
        posterior={name: p.value for name, p in posterior.items() if p.failed is None},
        refused={name: s.failed for name, s in every.items() if s.failed is not None},
        default_priors=defaults,
        correction=correction,
    )
    if not result.posterior:
        return result
    fits = {name: robust[name] for name in result.posterior}
    identified = {
        name: run(stage(f"{name}/identifiability", identifiability, rows, fit, priors))
        for name, fit in fits.items()
    }
    result = replace(result, identifiability={name: s.value for name, s in identified.items()})
    chains = {name: posterior[name] for name in result.posterior}
    fitted = _Fitted(rows, priors, fits, chains)
    return _measure(dataset, options, store, images, fitted, result, by_rows, mirror)


@dataclass(frozen=True)
class _Fitted:
    """Rows and fits as inputs of stages; the models in both mappings are the same."""

    rows: Staged[Observations]
    priors: Staged[Priors]
    robust: Mapping[str, Staged[RobustFit]]
    posterior: Mapping[str, Staged[Posterior]]


def _measure(
    dataset: Dataset,
    options: Options,
    store: Store,
    images: ImageStages,
    fitted: _Fitted,
    result: GazeResult,
    by_rows: Callable[[GazeResult], bool],
    mirror: Mirror | None,
) -> GazeResult:
    """Select a model and find what the instrument then measures."""
    run, seed, rows, priors = store.run, options.seed, fitted.rows, fitted.priors
    fits, posteriors = gather(fitted.robust), gather(fitted.posterior)
    validation = _validation(dataset, store, images)
    own = gaze_setup(dataset, images)
    setup = given("setup", own)
    if mirror is not None:
        setup = given("setup", mirror.setup(own))
        if validation is not None:
            validation = given("mirrored validation rows", mirror.validation(validation.value))
    references = rows.value.z_mm
    if validation is not None:
        references = np.append(references, validation.value.rows.z_mm)
    low, high = options.depths_mm or (float(references.min()), float(references.max()))
    history = given("row history", row_history(dataset))
    # fmt: off
    comparison = run(stage("comparison", compare_models,
                           rows, fits, posteriors, priors, optional(validation), seed=seed))
    selected = comparison.value.selected
    groups = run(stage("groups", check_groups, rows, fitted.robust[selected]))
    calibrated = run(stage("instrument", build_instrument,
                           fitted.posterior[selected], fitted.robust[selected], rows, setup))
    depths = run(stage("depths", tabulate_depths,
                       calibrated, low_mm=low, high_mm=high, seed=seed))
    diagnosis = run(stage("diagnosis", diagnose,
                          rows, priors, fitted.robust[selected],
                          history, depths, is_left=mirror is not None))
    average = run(stage("average", build_average,
                        posteriors, fits, comparison, rows, setup, calibrated, depths, seed=seed))
    measured = None
    if validation is not None:
        measured = run(stage("validation", measure_validation,
                             calibrated, validation, fits, seed=seed))
    diagnosis = run(stage("independent references", diagnose_references,
                          diagnosis, calibrated, fitted.robust[selected], rows,
                          optional(validation), optional(_lengths(dataset)), depths, history))
    # fmt: on
    result = replace(result, calibrated=calibrated.value)
    evidence = None
    if by_rows(result):
        evidence = run(
            certified(
                "", dataset, calibrated, rows, optional(validation), optional(measured), seed=seed
            )
        )
    return replace(
        result,
        comparison=comparison.value,
        depths=depths.value,
        average=average.value,
        validation=None if measured is None else measured.value,
        groups=groups.value,
        diagnosis=diagnosis.value,
        evidence=None if evidence is None else evidence.get(),
        not_certified=None if evidence is None else evidence.failed,
    )


def _corrected(
    dataset: Dataset,
    store: Store,
    rows: Staged[Observations],
    priors: Staged[Priors],
    *,
    is_left: bool,
) -> tuple[Staged[Observations], Attempt | None]:
    """Return the rows without the error of a cause that the manifest accepts, and the cause.

    Raises
    ------
    InputError
        If the rows cannot tell it.
    """
    stated = dataset.manifest.corrections
    if stated is None:
        return rows, None
    history = given("row history", row_history(dataset))
    found = store.run(
        stage(
            "correction", correct_rows, rows, priors, history,
            accepted=stated.accept, is_left=is_left,
        )
    )  # fmt: skip
    if found.failed is not None:
        raise InputError.single(
            where="dataset.toml, [corrections]",
            what=found.failed,
            remedy="remove the section, or mend the rows",
        )
    return given("corrected rows", found.value.rows), found.value.cause


def _lengths(dataset: Dataset) -> Staged[LengthTable] | None:
    return None if dataset.lengths is None else given("lengths", dataset.lengths)


def _validation(
    dataset: Dataset, store: Store, images: ImageStages
) -> Staged[ValidationRows] | None:
    """Return the validation rows; None without any, or where their images give nothing."""
    table = dataset.validation
    if table is None:
        return None
    stated = dataset.manifest.validation
    setup = given("setup", validation_setup(dataset, images))
    seen = image_observations(dataset, table, store, images)
    rows = store.run(
        stage(
            "validation rows",
            observe_validation,
            given("validation", table),
            setup,
            optional(seen),
            own_origin=stated is not None and stated.origin is not None,
        )
    )
    return rows if rows.failed is None else None
