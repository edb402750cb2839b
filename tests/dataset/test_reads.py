"""What is read decides how uncertain a reading is.

Evidence: simulated truth, a stepper that errs within its full steps; its amplitude by hand.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from calib.dataset.encoder import Encoder
from calib.dataset.load import load_dataset
from calib.geometry.plane import OBSERVABLE
from calib.simulate.contents import SimulationOptions
from calib.simulate.dataset import simulate_dataset
from tests.diagnosis.faulty_rigs import fitted_folder

STEP = 0.05625


def test_counts_of_a_stepper_err_within_its_full_step() -> None:
    assert Encoder(resolution_deg=STEP).further_u_deg == 0
    assert Encoder(resolution_deg=STEP, reads="load encoder").further_u_deg == 0
    counts = Encoder(resolution_deg=STEP, reads="counts", full_step_deg=1.8)
    # A sine of 5 % of a full step: its root mean square.
    np.testing.assert_allclose(counts.further_u_deg, 0.05 * 1.8 / np.sqrt(2))
    sixteen = Encoder(resolution_deg=STEP, reads="counts")
    np.testing.assert_allclose(sixteen.further_u_deg, 0.05 * 16 * STEP / np.sqrt(2))
    stated = Encoder(resolution_deg=STEP, reads="counts", u_alpha2_deg=0.01)
    assert stated.further_u_deg == 0.01
    assert 0 < Encoder(resolution_deg=STEP, reads="motor encoder").further_u_deg < STEP


def test_a_full_step_smaller_than_a_count_is_refused() -> None:
    with pytest.raises(ValidationError, match="smaller than one count"):
        Encoder(resolution_deg=STEP, full_step_deg=0.01)


def test_rows_of_a_stepper_are_as_uncertain_as_they_scatter(tmp_path: Path) -> None:
    scales: dict[str, list[float]] = {"counts": [], "load encoder": []}
    for seed in range(6):
        plain = tmp_path / f"plain-{seed}"
        simulate_dataset(plain, SimulationOptions(seed=seed, rows=40))
        encoder = load_dataset(plain).manifest.encoder
        assert encoder is not None
        resolution = encoder.resolution_deg
        folder = tmp_path / f"stepper-{seed}"
        # The makers' 5 %, on a coarse rig far above all other noise.
        faults = {"microstep": 0.05 * 16 * resolution}
        simulate_dataset(folder, SimulationOptions(seed=seed, rows=40, faults=faults))
        manifest = folder / "dataset.toml"
        text = manifest.read_text()
        own = [line for line in text.splitlines() if not line.startswith("u_alpha2_deg")]
        for reads, found in scales.items():
            told = [f'{line}\nreads = "{reads}"' if line == "[encoder]" else line for line in own]
            manifest.write_text("\n".join(told) + "\n")
            rows, _, fit, _ = fitted_folder(folder, "axis-offset")
            assert np.all(rows.std[:, OBSERVABLE.alpha2] > 0)
            found.append(fit.noise_scale)
    # Six rigs of 36 degrees of freedom tell the scale to 5 %.
    assert 0.8 < np.mean(scales["counts"]) < 1.15
    assert np.mean(scales["load encoder"]) > 1.15 * np.mean(scales["counts"])


def test_what_is_assumed_is_said(tmp_path: Path) -> None:
    simulate_dataset(tmp_path / "data", SimulationOptions(seed=0))
    manifest = tmp_path / "data" / "dataset.toml"
    lines = manifest.read_text().splitlines()
    lines = [line for line in lines if not line.startswith("u_alpha2_deg")]
    at = lines.index("[encoder]") + 1
    manifest.write_text("\n".join([*lines[:at], 'reads = "counts"', *lines[at:]]))
    (said,) = (w for w in load_dataset(tmp_path / "data").warnings if "u_alpha2_deg" in w)
    assert "motor's error between full steps" in said
