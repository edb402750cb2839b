"""Which mrcal there is, outside this environment: under the interpreter that has it.

Results depend on it as they do on a package, so fingerprints ask here.
"""

from __future__ import annotations

import os
import subprocess

INTERPRETER_VARIABLE = "CALIB_MRCAL_PYTHON"
"""Environment variable with the interpreter that has mrcal."""

DEFAULT_INTERPRETER = "/usr/bin/python3"
"""Where the distributions' package puts mrcal."""

PATIENCE_S = 20.0

# The file's date tells releases apart without the third of a second that importing mrcal takes.
_ASK = (
    "import importlib.util, os; s = importlib.util.find_spec('mrcal'); "
    "f = s and os.stat(s.origin); print(s and (s.origin, f.st_size, f.st_mtime_ns))"
)


def mrcal_interpreter() -> str:
    """Return the interpreter that has mrcal, if there is one."""
    return os.environ.get(INTERPRETER_VARIABLE, DEFAULT_INTERPRETER)


def mrcal_identity() -> str | None:
    """Return what tells this mrcal from another, None if there is none."""
    try:
        done = subprocess.run(  # noqa: S603 - no shell; the interpreter is the user's choice
            [mrcal_interpreter(), "-I", "-c", _ASK],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="backslashreplace",
            timeout=PATIENCE_S,
            check=False,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    said = done.stdout.strip()
    return said if done.returncode == 0 and said not in ("", "None") else None
