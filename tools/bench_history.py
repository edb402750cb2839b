"""Histories and batches timed: many folders indexed, many datasets on one worker and on two."""

from __future__ import annotations

import json
import re
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from datetime import date, timedelta
from hashlib import sha256
from pathlib import Path

import numpy as np

from calib.stages.manifest import end_outputs

CALIB = [sys.executable, "-m", "calib"]

RIGS, EACH = 200, 50

DATASETS = 40

READ_BY_INDEX = ("calibration.json", "certificate.xml", "run.toml")


@dataclass(frozen=True)
class Took:
    """Seconds by the clock and of CPU, those of child processes with them."""

    clock: float
    cpu: float


def took(*command: object) -> Took:
    """Return what a command of the program took."""
    before, started = _children(), time.perf_counter()
    subprocess.run([*CALIB, *map(str, command)], check=True, capture_output=True)
    return Took(time.perf_counter() - started, _children() - before)


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def fleet(run: Path, top: Path) -> None:
    """Write folders like those of real runs: the files of one, with values drawn about its own."""
    rng = np.random.default_rng(0)
    names = {name: (run / name).read_text(encoding="utf-8") for name in READ_BY_INDEX}
    document = json.loads(names["calibration.json"])
    measurement, dataset = document["measurement"], document["dataset"]
    values = rng.multivariate_normal(
        measurement["values"], measurement["covariance"], (RIGS, EACH), check_valid="ignore"
    )
    for i in range(RIGS):
        for k in range(EACH):
            folder = top / f"{i:03d}" / f"{k:02d}"
            folder.mkdir(parents=True)
            digest = sha256(f"{i} {k}".encode()).hexdigest()
            text = {
                "calibration.json": json.dumps({
                    **document,
                    "rig": {**document.get("rig", {}), "serial": f"R{i:03d}"},
                    "dataset": {**dataset, "sha256": digest},
                    "measurement": {**measurement, "values": values[i, k].tolist()},
                }, indent=2),
                "certificate.xml": names["certificate.xml"].replace(dataset["sha256"], digest),
                "run.toml": re.sub(
                    r"finished = .*",
                    f'finished = "{date(2014, 1, 1) + timedelta(days=90 * k)}T08:00:00+00:00"',
                    names["run.toml"],
                ),
            }  # fmt: skip
            for name, content in text.items():
                (folder / name).write_text(content, encoding="utf-8")
            for name in ("results.h5", "report.html"):
                (folder / name).write_text("")
            end_outputs(folder, "", (*text, "results.h5", "report.html"))


def index_and_pages(dataset: Path) -> dict[str, Took]:
    """Return what the commands take on the fleet."""
    with tempfile.TemporaryDirectory() as name:
        top = Path(name)
        took("calibrate", dataset, "--out", top / "run")
        fleet(top / "run", top / "runs")
        file = ("--index", top / "history.sqlite")
        out = ("--out", top / "pages")
        return {
            f"index of {RIGS * EACH:,} calibrations": took("history", "index", top / "runs", *file),
            "the same again": took("history", "index", top / "runs", *file),
            f"overview and pages of {RIGS} rigs": took("history", "page", *file, *out),
            f"page of a rig with {EACH} calibrations": took(
                "history", "page", "--rig", "R007", *file, *out
            ),
        }


@dataclass(frozen=True)
class Batch:
    """A batch on a local Dask cluster.

    Parameters
    ----------
    busy
        Share of the workers' time in which they calibrated.
    """

    took: Took
    busy: float


def batch(datasets: list[Path], out: Path, *, workers: int) -> Batch:
    """Return what a batch takes on a cluster of its own, from the command to its summary."""
    import distributed

    before = _children()
    with (
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        client.get_task_stream()  # begins the recording
        command = ("batch", *datasets, "--out", out, "--scheduler", cluster.scheduler_address)
        clock = took(*command).clock
        spans = [s for task in client.get_task_stream() for s in task["startstops"]]
    busy = sum(s["stop"] - s["start"] for s in spans if s["action"] == "compute")
    return Batch(Took(clock, _children() - before), busy / (workers * clock))


def batches() -> tuple[Batch, Batch]:
    """Return simulated datasets calibrated by one worker and by two."""
    with tempfile.TemporaryDirectory() as name:
        top = Path(name)
        datasets = [top / "sets" / f"{seed:02d}" for seed in range(1, DATASETS + 1)]
        for seed, dataset in enumerate(datasets, 1):
            took("simulate", dataset, "--seed", seed)
        return (
            batch(datasets, top / "one", workers=1),
            batch(datasets, top / "two", workers=2),
        )
