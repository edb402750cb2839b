"""What the user sees while a run goes on, and at its end."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from tqdm import tqdm


class Console:
    """Names each stage as it starts; a bar for long ones, on a terminal only."""

    def __init__(self) -> None:
        self._bar: tqdm[Any] | None = None
        self._stage = ""

    def announce(self, name: str) -> None:
        """Say that a stage starts."""
        self.close()
        self._stage = name
        print(f"  {name}", file=sys.stderr, flush=True)

    def progress(self, name: str, done: int, expected: int) -> None:
        """Show how far a stage is."""
        if not sys.stderr.isatty():
            return
        if self._bar is None:
            self._bar = tqdm(desc=f"  {name}", file=sys.stderr, leave=False, unit="step")
        self._bar.total = max(expected, done)
        self._bar.n = done
        self._bar.refresh()

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None


def summary(out: Path) -> tuple[str, bool]:
    """Return the end of a run in a few lines, and whether all gates passed."""
    result: dict[str, Any] = json.loads((out / "calibration.json").read_text(encoding="utf-8"))
    lines = []
    selected = result.get("selected")
    if selected is not None:
        lines.append(f"selected model: {selected}")
        fit = result["fits"][f"{selected}/posterior"]
        everything = fit["parameters"] | fit.get("derived", {})
        for name, estimate in everything.items():
            decided = " (decided by its prior)" if estimate.get("identified_by") == "prior" else ""
            figures = f"{estimate['value']:12.5g} +- {estimate['std']:.2g}"
            lines.append(f"  {name:24s} {figures}{decided}")
    failed = [gate for gate in result["gates"] if not gate["passed"]]
    lines += [f"GATE FAILED  {gate['name']}: {gate['detail']}" for gate in failed]
    lines += [f"warning: {text}" for text in result.get("warnings", [])]
    lines.append(f"results in {out}")
    return "\n".join(lines), not failed
