"""What the user sees while a run goes on, and at its end."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from tqdm import tqdm

from calib.core.errors import harmless
from calib.uncertainty.format import interval


class Console:
    """Names each stage as it starts; a bar for each long one at work, on a terminal only."""

    def __init__(self) -> None:
        self._bars: dict[str, tqdm[Any]] = {}

    def announce(self, name: str) -> None:
        """Say that a stage starts."""
        self.close()
        print(f"  {name}", file=sys.stderr, flush=True)

    def progress(self, name: str, done: int, expected: int) -> None:
        """Show how far a stage is."""
        if not sys.stderr.isatty():
            return
        if name not in self._bars:
            self._bars[name] = tqdm(
                desc=f"  {name}",
                file=sys.stderr,
                leave=False,
                unit="step",
                position=len(self._bars),
            )
        bar = self._bars[name]
        bar.total = max(expected, done)
        bar.n = done
        bar.refresh()

    def close(self) -> None:
        """Take the bars away; those of stages still at work come back at their next step."""
        while self._bars:
            self._bars.popitem()[1].close()


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
            by_prior = estimate.get("identified_by") == "prior"
            decided = " (identified by prior knowledge)" if by_prior else ""
            figures = f"{estimate['value']:12.5g} +- {estimate['std']:.2g}"
            if "q2.5" in estimate and name in fit.get("derived", {}):
                low, high = interval(
                    estimate["q2.5"], estimate["q97.5"], uncertainty=estimate["std"]
                )
                figures += f" (95 %: {low} to {high})"
            lines.append(f"  {name:24s} {figures}{decided}")
    failed = [gate for gate in result["gates"] if not gate["passed"]]
    lines += [_cause(cause) for cause in result.get("diagnosis", [])]
    lines += [f"GATE FAILED  {gate['name']}: {gate['detail']}" for gate in failed]
    lines += [f"warning: {text}" for text in result.get("warnings", [])]
    lines.append(f"results in {harmless(str(out))}")
    return "\n".join(lines), not failed


def _cause(cause: dict[str, Any]) -> str:
    """Return a diagnosed cause in one line."""
    before, after = cause["noise_scale"]
    return (
        f"CAUSE  {cause['cause']}: {cause['text']} (residuals {before:.2g} times what is stated, "
        f"{after:.2g} with it; evidence {cause['gain']:.0f} nats)"
    )
