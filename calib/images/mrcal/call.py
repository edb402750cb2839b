"""Runs mrcal in a process of its own, arrays to and fro in ``.npz`` files.

mrcal is on no Python registry; it comes with the system and is tied to the system's numpy. So the
system's interpreter runs `worker`, once a solve. That also keeps a crash of its C library
away from this process.
"""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from calib.core.errors import CalibError, EstimationError
from calib.core.mrcal_python import INTERPRETER_VARIABLE, mrcal_interpreter
from calib.core.parent import ending_with_this

if TYPE_CHECKING:
    # Run elsewhere, but the results depend on it: fingerprints follow imports.
    from calib.images.mrcal import worker  # noqa: F401 - see above

INSTALL = "apt install python3-mrcal"
"""How Debian and Ubuntu users get mrcal."""

TIMEOUT_S, TIMEOUT_VIEWS = 300.0, 100
"""A solve takes one second with 50 views and about ten with a splined lens; this one hangs. With
more views it has as many times as long."""

_WORKER = Path(__file__).with_name("worker.py")
_MISSING = 4
_LAST_WORDS = 300


class MrcalMissingError(CalibError):
    """There is no mrcal on this machine; the other backend goes on alone."""


def call_worker(arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Run the worker on the arrays of a request; return those of its reply.

    Raises
    ------
    MrcalMissingError
        If this machine has no mrcal.
    EstimationError
        If mrcal fails, crashes or hangs.
    """
    interpreter = mrcal_interpreter()
    timeout = TIMEOUT_S * max(1.0, len(arrays["observations"]) / TIMEOUT_VIEWS)
    # The variables that steer this interpreter are not meant for that one. One thread: the sums,
    # and so the last digits, are then the same on every machine.
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    environment |= ending_with_this()
    environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory(prefix="calib-mrcal-") as name:
        folder = Path(name)
        np.savez(folder / "request.npz", allow_pickle=False, **arrays)
        try:
            # -I: neither this folder, whose types.py would hide Python's own, nor the user's.
            done = subprocess.run(  # noqa: S603 - no shell; the interpreter is the user's choice
                [interpreter, "-I", str(_WORKER), name],
                cwd=folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=timeout,
                check=False,
            )
        except OSError as error:
            raise MrcalMissingError(_missing(interpreter, str(error))) from error
        except subprocess.TimeoutExpired as error:
            raise EstimationError(
                f"mrcal gave no answer within {timeout:.0f} s; use fewer views or a lens model "
                "with fewer parameters"
            ) from error
        words = _last_words(done.stderr)
        if done.returncode == _MISSING:
            raise MrcalMissingError(_missing(interpreter, words))
        if done.returncode:
            raise EstimationError(f"mrcal {_manner(done.returncode)}: {words}")
        try:
            with (
                (folder / "reply.npz").open("rb") as reply,
                np.load(reply, allow_pickle=False) as file,
            ):
                return {key: file[key] for key in file.files}
        except (OSError, ValueError, EOFError, BadZipFile) as error:
            raise EstimationError(
                f"{interpreter} ended without an answer of mrcal ({words}); is it a Python "
                f"interpreter? name the one that has mrcal in {INTERPRETER_VARIABLE}"
            ) from error


def _missing(interpreter: str, words: str) -> str:
    return (
        f"{interpreter} has no mrcal ({words}): the cross-check by a second backend is missing; "
        f"install it ({INSTALL}) or name the interpreter that has it in {INTERPRETER_VARIABLE}"
    )


def _manner(returncode: int) -> str:
    """Say how the worker ended."""
    if returncode > 0:
        return "failed"
    name = signal.Signals(-returncode).name
    if -returncode == signal.SIGKILL:
        return f"was killed ({name}), as systems do that run out of memory"
    return f"crashed with {name}"


def _last_words(stderr: bytes) -> str:
    """Return the last line of the worker's error stream, shortened."""
    lines = [line.strip() for line in stderr.decode("utf-8", "replace").splitlines()]
    return next((line for line in reversed(lines) if line), "no message")[-_LAST_WORDS:]
