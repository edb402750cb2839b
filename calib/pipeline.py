"""The whole chain: stages in their order, then the outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.dataset.contents import Dataset
from calib.dataset.tables import GazeTable
from calib.fit.posterior import Posterior
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit
from calib.geometry.parameters import MODELS
from calib.ledger import run_fingerprint
from calib.observations import Observations
from calib.observe import CameraSet, RowSettings, Shared, row_settings, validation_settings
from calib.outputs import write_outputs
from calib.results import Calibration, GazeResult
from calib.store import Staged, Store, given
from calib.verdict import gaze_gates, gaze_warnings


@dataclass(frozen=True)
class Options:
    """What the user may choose of a run.

    Parameters
    ----------
    seed
        Of all random numbers.
    depths_mm
        Least and greatest depth of the uncertainty table; None for those of the rows.
    """

    seed: int = 0
    depths_mm: tuple[float, float] | None = None


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
        gaze = None if dataset.gaze is None else _gaze_chain(dataset, dataset.gaze, options, store)
        calibration = Calibration(
            name=dataset.manifest.name,
            title=dataset.manifest.title,
            sha256=dataset.sha256,
            seed=options.seed,
            cameras=dataset.cameras,
            gaze=gaze,
            gates=() if gaze is None else gaze_gates(gaze),
            warnings=(*dataset.warnings, *(() if gaze is None else gaze_warnings(gaze))),
        )
        written = write_outputs(calibration, store, fingerprint=fingerprint, command=command)
    return Run(calibration, tuple(store.durations), tuple(store.reused), written)


@dataclass(frozen=True)
class _Given:
    """What the manifest says, as inputs of stages."""

    settings: Staged[RowSettings]
    cameras: Staged[CameraSet]
    shared: Staged[Shared]
    priors: Staged[Priors]


def _gaze_chain(dataset: Dataset, table: GazeTable, options: Options, store: Store) -> GazeResult:
    """From gaze rows to the calibrated instrument and what it measures."""
    stage = store.stage
    known = _Given(
        settings=given("settings", row_settings(dataset)),
        cameras=given("cameras", CameraSet(dataset.cameras.get("c1"), dataset.cameras.get("c2"))),
        shared=given("shared errors", Shared()),
        priors=given("priors", Priors(dict(dataset.manifest.priors))),
    )
    # fmt: off
    rows = stage("observations", "calib.observe:observe",
                 given("gaze", table), known.settings, known.cameras, known.shared, None)
    sense = stage("sense", "calib.fit.sense:check_sense", rows)
    linear = stage("base/linear", "calib.fit.linear:fit_linear", rows)
    convex = stage("base/convex", "calib.fit.convex:fit_convex", rows)
    robust = {model: stage(f"{model}/robust", "calib.fit.robust:fit_model",
                           rows, known.priors, model=model) for model in MODELS}
    posterior = {model: stage(f"{model}/posterior", "calib.fit.posterior:sample_posterior",
                              rows, fit, known.priors, seed=options.seed)
                 for model, fit in robust.items() if fit.failed is None}
    # fmt: on
    every = {"base/linear": linear, "base/convex": convex}
    every |= {f"{name}/robust": fit for name, fit in robust.items()}
    every |= {f"{name}/posterior": chain for name, chain in posterior.items()}
    result = GazeResult(
        rows=rows.value,
        sense=sense.value,
        linear=linear.get(),
        convex=convex.get(),
        robust={name: robust[name].value for name, p in posterior.items() if p.failed is None},
        posterior={name: p.value for name, p in posterior.items() if p.failed is None},
        refused={name: s.failed for name, s in every.items() if s.failed is not None},
    )
    if not result.posterior:
        return result
    fits = {name: robust[name] for name in result.posterior}
    chains = {name: posterior[name] for name in result.posterior}
    return _measure(dataset, options, store, _Fitted(known, rows, fits, chains), result)


@dataclass(frozen=True)
class _Fitted:
    """Rows and fits as inputs of stages; the models in both mappings are the same."""

    known: _Given
    rows: Staged[Observations]
    robust: Mapping[str, Staged[RobustFit]]
    posterior: Mapping[str, Staged[Posterior]]


def _measure(
    dataset: Dataset, options: Options, store: Store, fitted: _Fitted, result: GazeResult
) -> GazeResult:
    """Select a model and find what the instrument then measures."""
    stage, seed, known, rows = store.stage, options.seed, fitted.known, fitted.rows
    low, high = options.depths_mm or _depth_range(dataset, rows.value)
    # fmt: off
    validation = None
    if dataset.validation is not None:
        validation = stage("validation rows", "calib.observe:observe_validation",
                           given("validation", dataset.validation),
                           given("validation settings", validation_settings(dataset)),
                           known.cameras, known.shared, None)
    comparison = stage("comparison", "calib.fit.compare:compare_models",
                       rows, fitted.robust, fitted.posterior, known.priors, validation, seed=seed)
    selected = comparison.value.selected
    calibrated = stage("instrument", "calib.instrument:build_instrument",
                       fitted.posterior[selected], fitted.robust[selected], rows, known.settings)
    depths = stage("depths", "calib.instrument:tabulate_depths",
                   calibrated, low_mm=low, high_mm=high, seed=seed)
    measured = None
    if validation is not None:
        measured = stage("validation", "calib.instrument:measure_validation",
                         calibrated, validation, fitted.robust, seed=seed)
    # fmt: on
    return replace(
        result,
        comparison=comparison.value,
        calibrated=calibrated.value,
        depths=depths.value,
        validation=None if measured is None else measured.value,
    )


def _depth_range(dataset: Dataset, rows: Observations) -> tuple[float, float]:
    """Return the least and greatest reference depth of calibration and validation rows, mm."""
    depths = [rows.z_mm]
    if dataset.validation is not None:
        depths.append(dataset.validation.z_mm)
    every = np.concatenate(depths)
    return float(np.nanmin(every)), float(np.nanmax(every))
