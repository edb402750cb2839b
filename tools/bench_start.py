"""What a run takes beside the bare imports of its libraries."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from statistics import median

RUN = """
import sys
from calib.cli.main import main
status = main(["calibrate", sys.argv[1], "--out", sys.argv[2], "--quiet"])
installed = [
    name for name, module in sys.modules.items()
    if "site-packages" in (getattr(module, "__file__", None) or "") and module.__name__ == name
]
print("MODULES", *installed)
sys.exit(status)
"""

IMPORT = "import importlib, sys; [importlib.import_module(name) for name in sys.argv[1:]]"


@dataclass(frozen=True)
class Beside:
    """CPU seconds of a whole run, of the imports in it alone, and their ratio: medians."""

    run: float
    imports: float
    ratio: float


def beside_imports(dataset: Path, *, repeats: int) -> Beside:
    """Calibrate a dataset and import the same modules bare, in turn, each in a new process."""
    runs, imports = [], []
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as out:
            seconds, said = _child([RUN, str(dataset), out])
        runs.append(seconds)
        imports.append(_child([IMPORT, *said.split("MODULES", 1)[1].split()])[0])
    ratio = median(run / alone for run, alone in zip(runs, imports, strict=True))
    return Beside(median(runs), median(imports), ratio)


def _child(code: list[str]) -> tuple[float, str]:
    """Return the CPU seconds of a Python process, those of its exit too, and what it wrote."""
    before = _used()
    done = subprocess.run(
        [sys.executable, "-c", *code], capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 3):
        raise SystemExit(f"bench: {done.stderr}")
    return _used() - before, done.stdout


def _used() -> float:
    times = os.times()
    return times.children_user + times.children_system
