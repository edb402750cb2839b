"""Simulated tables with a mistake, and what the diagnosis makes of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calib.dataset.load import load_dataset
from calib.diagnosis.engine import Tried
from calib.diagnosis.session import row_history
from calib.fit.priors import Priors
from calib.fit.robust import RobustFit, fit_model
from calib.rows.from_table import Setup, row_priors, row_settings
from calib.rows.observations import Observations
from calib.rows.repeated_readings import observe_gazes
from calib.simulate.contents import SimulationOptions
from calib.simulate.dataset import simulate_dataset


def tried_on(
    top: Path, fault: str | None = None, value: float | None = None, **options: Any
) -> Tried:
    """Return what the hypotheses make of a simulated rig on the right."""
    rows, priors, fit, dataset = fitted(top, fault, value, **options)
    found = Tried.of(rows, priors, fit, row_history(dataset), is_left=False)
    assert found is not None
    return found


def fitted(
    top: Path, fault: str | None = None, value: float | None = None, **options: Any
) -> tuple[Observations, Priors, RobustFit, Any]:
    """Return rows, priors, robust fit and dataset of a simulated rig."""
    settings = {"rows": 24, "model": "axis-offset", "seed": 1} | options
    folder = top / f"{fault}-{settings['seed']}-{settings['rows']}"
    if not folder.exists():
        faults = {} if fault is None else {fault: value}
        simulate_dataset(folder, SimulationOptions(faults=faults, **settings))
    return fitted_folder(folder, settings["model"])


def fitted_folder(folder: Path, model: str) -> tuple[Observations, Priors, RobustFit, Any]:
    """Return rows, priors, robust fit and dataset of a folder."""
    dataset = load_dataset(folder)
    assert dataset.gaze is not None
    rows = observe_gazes(dataset.gaze, Setup(row_settings(dataset)), None)
    priors = Priors(row_priors(dataset))
    return rows, priors, fit_model(rows, priors, model=model), dataset
