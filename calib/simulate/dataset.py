"""Writes a simulated dataset, whole or not at all."""

from __future__ import annotations

import csv
import json
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w

from calib.core.errors import UsageError
from calib.simulate.contents import Contents, CsvTable, RenderedShot, SimulationOptions
from calib.simulate.pattern import board_pattern
from calib.simulate.plan import plan_dataset
from calib.simulate.render import Optics, prepare, render

PNG_COMPRESSION = 1
"""Noise hardly compresses: the highest level takes eight times as long and saves 8 %."""


def simulate_dataset(
    out: Path,
    options: SimulationOptions,
    *,
    optics: Optics | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Contents:
    """Simulate a rig and write its dataset, format 1, with the truth in ``truth.json``.

    The folder appears when it is complete: it is written beside `out` and renamed. The same
    options and optics give the same bytes.

    Parameters
    ----------
    out
        Folder to create; may exist if it is empty.
    optics
        Blur, noise and vignetting of rendered images.
    progress
        Called with the number of images written and their total.

    Raises
    ------
    UsageError
        If `out` is not empty or cannot be written, or the options make no dataset.
    """
    out = out.resolve()
    _refuse_occupied(out)
    contents = plan_dataset(options)
    partial = out.with_name(f".{out.name}.{os.getpid()}.partial")
    try:
        partial.mkdir(parents=True)
        _write_tables(partial, contents)
        _write_images(partial, contents, optics or Optics(), seed=options.seed, progress=progress)
        partial.rename(out)
    except OSError as error:
        raise UsageError(f"cannot write {out}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return contents


def _refuse_occupied(out: Path) -> None:
    occupied = any(out.iterdir()) if out.is_dir() else out.exists() or out.is_symlink()
    if occupied:
        raise UsageError(f"{out} exists already; name a new folder or remove it first")


def _write_tables(folder: Path, contents: Contents) -> None:
    (folder / "dataset.toml").write_text(tomli_w.dumps(contents.manifest), encoding="utf-8")
    (folder / "truth.json").write_text(json.dumps(contents.truth, indent=1) + "\n", "utf-8")
    for name, table in contents.tables.items():
        _write_csv(folder / name, table)


def _write_csv(path: Path, table: CsvTable) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table.columns)
        # Twelve digits: below every noise, and a count of the encoder reads as it should.
        writer.writerows(
            [f"{cell:.12g}" if isinstance(cell, float) else cell for cell in row]
            for row in table.rows
        )


def _write_images(
    folder: Path,
    contents: Contents,
    optics: Optics,
    *,
    seed: int,
    progress: Callable[[int, int], None] | None,
) -> None:
    if not contents.shots:
        return
    pattern = board_pattern(contents.board)
    # Each image has its own stream, so the order in which threads finish does not matter.
    streams = np.random.default_rng([seed, 1]).spawn(len(contents.shots))
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
        cameras = {"c1": contents.rig.c1, "c2": contents.rig.c2}
        imagers = dict(
            zip(cameras, pool.map(lambda c: prepare(c, optics), cameras.values()), strict=True)
        )

        def expose(shot: RenderedShot, rng: np.random.Generator) -> None:
            path = folder / shot.path
            path.parent.mkdir(parents=True, exist_ok=True)
            _write_png(path, render(imagers[shot.camera], pattern, shot.pose, rng))

        for done, _ in enumerate(pool.map(expose, contents.shots, streams), 1):
            if progress is not None:
                progress(done, len(contents.shots))


def _write_png(path: Path, image: Any) -> None:
    _, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, PNG_COMPRESSION])
    path.write_bytes(data.tobytes())
