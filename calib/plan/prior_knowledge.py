"""What is known before a plan: the rows so far, the cameras, what was measured."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from calib.checks.verdict import all_gates
from calib.core.errors import UsageError
from calib.core.gate import Gate, failed
from calib.dataset.contents import Dataset
from calib.fit.priors import MeasuredParameters
from calib.rows.from_table import CameraSet, Setup, row_settings
from calib.rows.observations import Observations
from calib.rows.repeated_readings import observe_gazes
from calib.stages.owner import claim
from calib.stages.store import Store


@dataclass(frozen=True)
class PriorKnowledge:
    """What is known before a plan.

    Parameters
    ----------
    rows
        None if there are none yet.
    cameras
        As far as they are known.
    measured
        What the yaw sweep measured; None without one.
    baseline_mm
        X of C2 in C1 by the stereo reference; None without one.
    failed_gates
        Of lenses, pairs and sweep.
    """

    rows: Observations | None
    cameras: CameraSet
    measured: MeasuredParameters | None = None
    baseline_mm: float | None = None
    failed_gates: tuple[Gate, ...] = ()


def needs_images(dataset: Dataset) -> bool:
    """Return whether rows or cameras come from images: a board is stated for nothing else."""
    return dataset.board is not None


def from_tables(dataset: Dataset) -> PriorKnowledge:
    """Return what is known of a dataset without images."""
    cameras = CameraSet(dataset.cameras.get("c1"), dataset.cameras.get("c2"))
    if dataset.gaze is None:
        return PriorKnowledge(None, cameras)
    setup = Setup(row_settings(dataset), cameras)
    return PriorKnowledge(observe_gazes(dataset.gaze, setup, None), cameras)


def from_images(dataset: Dataset, store: Store) -> PriorKnowledge:
    """Return what is known of a dataset with images.

    By the stages of `calib calibrate`, kept in its folder: what is there is used, what is missing
    or out of date is made and stays there for the next run.

    Raises
    ------
    InputError, UsageError
        If the images or the folder cannot be used.
    EstimationError
        If the images do not give the rows.
    """
    from calib.chain.images import image_stages
    from calib.chain.rows import gaze_rows

    seed = _seed_of(dataset, store.out)
    with store.locked():
        claim(store.out, dataset.owner)
        images = image_stages(dataset, store, seed)
        rows = None
        if dataset.gaze is not None:
            rows = gaze_rows(dataset, dataset.gaze, store, images).value
        stereo = None if images.stereo is None else images.stereo.get()
        return PriorKnowledge(
            rows=rows,
            cameras=images.cameras,
            measured=images.measured(),
            baseline_mm=None if stereo is None else float(stereo.transform_12[0, 3]),
            failed_gates=failed(all_gates(images.result(), None, {})),
        )


def _seed_of(dataset: Dataset, out: Path) -> int:
    """Return the seed of the run in a folder, whose stages are then reused; 0 without a run.

    Raises
    ------
    UsageError
        If the run is that of another dataset: its stages would be lost.
    """
    path = out / "calibration.json"
    if not path.exists():
        return 0
    try:
        run = json.loads(path.read_text(encoding="utf-8"))
        name, seed = run["dataset"]["name"], run["seed"]
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise UsageError(f"{path}: cannot be read; name another folder with --run") from error
    if name != dataset.manifest.name:
        raise UsageError(
            f"--run {out}: holds a run of {name!r}, not of {dataset.manifest.name!r}; name the "
            "folder of this dataset's runs, or a new one"
        )
    return seed if type(seed) is int and seed >= 0 else 0
