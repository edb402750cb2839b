"""Two mistakes at once: both are named, each with its size as it is beside the other.

Evidence: simulated truth. Negative control: one mistake alone leaves nothing beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from faulty_rigs import fitted_folder

from calib.diagnosis.correction import correct_rows
from calib.diagnosis.engine import Tried
from calib.diagnosis.hypotheses import HYPOTHESES
from calib.diagnosis.second import Task
from calib.diagnosis.session import row_history
from calib.simulate.contents import SimulationOptions
from calib.simulate.dataset import simulate_dataset


def task_of(
    folder: Path, faults: Mapping[str, float | None], *, rows: int = 40, seed: int = 3
) -> Task:
    simulate_dataset(folder, SimulationOptions(seed=seed, rows=rows, faults=faults))
    observed, priors, fit, dataset = fitted_folder(folder, "axis-offset")
    return Task(observed, priors, fit, row_history(dataset))


def found(task: Task) -> tuple[Tried, Tried | None]:
    tried = task.tried()
    assert tried is not None
    return task.with_second(tried)


@pytest.mark.parametrize(
    ("first", "second", "seed"),
    [
        ({"unit": None}, {"rehomed": 0.4}, 7),
        ({"range-not-depth": None}, {"reading-step": 0.3}, 6),
        ({"reading-drift": 0.4}, {"rows-exchanged": None}, 9),
    ],
)
def test_both_are_named(
    first: dict[str, float | None], second: dict[str, float | None], seed: int, tmp_path: Path
) -> None:
    tried, beside = found(task_of(tmp_path / "d", first | second, seed=seed))
    assert beside is not None
    assert {tried.named[0], beside.named[0]} == {*first, *second}


def test_a_pair_that_no_single_cause_leads_to_is_found_with_both_sizes(tmp_path: Path) -> None:
    """Sides of approach are lost among wrong depths, and these among the sides."""
    task = task_of(tmp_path / "d", {"backlash": 0.3, "reference-bias-far": 4.0}, seed=4)
    alone = task.tried()
    assert alone is not None
    assert not {"backlash", "reference-bias-far"} & set(alone.named)
    tried, beside = found(task)
    assert beside is not None
    assert (tried.named, beside.named) == (("backlash",), ("reference-bias-far",))
    for outcome, name, size in (
        (tried.outcomes["backlash"], "backlash", 0.3),
        (beside.outcomes["reference-bias-far"], "reference-bias-far", 4.0),
    ):
        unit = HYPOTHESES[name].per_unit
        std = float(np.sqrt(outcome.covariance[0, 0])) / unit
        assert std < size / 8
        assert abs(float(outcome.values[0]) / unit - size) < 4 * std


@pytest.mark.parametrize("fault", ["reading-step", "backlash", "reference-bias-far", "unit"])
def test_one_mistake_leaves_nothing_beside_it(fault: str, tmp_path: Path) -> None:
    tried, beside = found(task_of(tmp_path / "d", {fault: None}, seed=1))
    assert tried.named[0] == fault
    assert beside is None, beside and beside.named


def test_backlash_of_unknown_sides_is_corrected_and_not_doubled(tmp_path: Path) -> None:
    """Whatever side is called the upper one, corrected readings scatter less."""
    for seed in range(1, 5):
        task = task_of(tmp_path / str(seed), {"backlash": 0.4}, seed=seed)
        corrected = correct_rows(
            task.rows, task.priors, task.history, accepted="backlash", is_left=False
        )
        moved = np.rad2deg(corrected.rows.alpha2_rad - task.rows.alpha2_rad)
        assert np.allclose(np.abs(moved), 0.2, atol=0.06)
        again = Task(corrected.rows, task.priors, task.fit, task.history).tried()
        assert again is not None
        assert again.base.refit.scale < 1.6
