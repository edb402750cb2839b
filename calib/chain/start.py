"""The chain from Python: `calib.calibrate`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from calib.core.errors import CalibError
from calib.core.gate import Gate
from calib.core.parent import ending_with_this
from calib.dataset.load import load_dataset
from calib.instrument.rig import RESULT, Rig, load
from calib.stages.manifest import refuse_broken

DONE, GATE_FAILED = 0, 3


@dataclass(frozen=True)
class FinishedRun:
    """A finished run.

    Parameters
    ----------
    folder
        With report, certificate, calibration.json and the rest.
    """

    folder: Path

    @cached_property
    def document(self) -> Mapping[str, Any]:
        """What calibration.json says, as Python objects."""
        file = self.folder / RESULT
        content = file.read_bytes()
        refuse_broken(file, content)
        found: Mapping[str, Any] = json.loads(content)
        return found

    @property
    def gates(self) -> tuple[Gate, ...]:
        """All checks of the result, with the figures that decided them."""
        return tuple(
            Gate(gate["name"], bool(gate["passed"]), gate["detail"])
            for gate in self.document["gates"]
        )

    @property
    def passed(self) -> bool:
        """Whether the result may be used."""
        return all(gate.passed for gate in self.gates)

    @property
    def rig(self) -> Rig:
        """The calibrated rig, as `calib.load` returns it.

        Raises
        ------
        InputError
            If the dataset had no gaze rows that could be fitted.
        """
        return load(self.folder)


def calibrate(
    dataset: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    seed: int = 0,
    depths_mm: tuple[float, float] | None = None,
    method: Literal["rows", "adjustment"] | None = None,
    force: bool = False,
) -> FinishedRun:
    """Run the whole chain on a dataset, as ``calib calibrate`` does.

    It runs in a process of its own, so that the bytes of calibration.json do not depend on how
    many threads this one gives to linear algebra. Finished stages of an earlier run are reused.

    Parameters
    ----------
    dataset
        Folder with dataset.toml.
    out
        Folder for the results; default: reports/NAME.
    seed
        Of all random numbers.
    depths_mm
        Least and greatest depth of the uncertainty table; default: those of the rows.
    method
        From what the instrument is taken, the gaze rows or the adjustment of all pictures; default:
        from the adjustment where there is one and the rows agree with it.
    force
        Whether a folder with files of another origin may be filled.

    Returns
    -------
    Calibrated
        Look at `FinishedRun.passed` before the result is used.

    Raises
    ------
    InputError
        If the dataset is not what it should be; `InputError.problems` name file, row and remedy.
    CalibError
        If its images cannot be used, an argument is wrong, or the folder may not be written.
    """
    load_dataset(Path(dataset))
    out = Path("reports") / Path(dataset).resolve().name if out is None else Path(out)
    options = ["--out", os.fspath(out), "--seed", str(seed)]
    if depths_mm is not None:
        options += ["--depths", *map(str, depths_mm)]
    if method is not None:
        options += ["--method", method]
    options += ["--force"] * force
    ended = subprocess.run(  # noqa: S603 - this interpreter, and arguments that no shell sees
        [sys.executable, "-P", "-m", "calib", "calibrate", *options, "--", os.fspath(dataset)],
        env={**os.environ, **ending_with_this()},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        encoding="utf-8",
        errors="replace",
        check=False,
    )
    if ended.returncode not in (DONE, GATE_FAILED):
        raise CalibError(_told(ended.returncode, ended.stderr))
    return FinishedRun(out)


def _told(status: int, stderr: str) -> str:
    """Return what the command said at its end: all from the last line that begins with its name."""
    start = stderr.rfind("calib: ")
    text = stderr[start:].removeprefix("calib: ").strip() if start >= 0 else stderr.strip()
    return text or f"calib calibrate ended with status {status}"
