"""What the user sees while a run goes on, and at its end."""

from __future__ import annotations

import json
import math
import sys
import threading
import tomllib
from pathlib import Path
from typing import Any

from tqdm import tqdm

from calib.cli.voice import painted
from calib.core.errors import harmless
from calib.uncertainty.format import interval, with_uncertainty

HEARTBEAT_S = 0.5
"""Between redraws of a terminal: whoever watches sees that the program is alive."""

_CLOCK = "{desc}: {elapsed}"
"""Of a stage that does not say how far it is."""


class Console:
    """Names each stage as it starts; a bar for each long one at work, on a terminal only.

    Between the steps that stages tell of, and in those that tell of none, as solves by libraries
    and work in other processes, a thread moves the bars.

    Parameters
    ----------
    quiet
        Whether to say nothing at all.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self._quiet = quiet
        self._bars: dict[str, tqdm[Any]] = {}
        self._last: str | None = None
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def announce(self, name: str) -> None:
        """Say that a stage starts."""
        if self._quiet:
            return
        with self._lock:
            self._clear()
            print(f"  {name}", file=sys.stderr, flush=True)
            self._last = name
        if sys.stderr.isatty():
            self._begin()

    def progress(self, name: str, done: int, expected: int) -> None:
        """Show how far a stage is."""
        if self._quiet or not sys.stderr.isatty():
            return
        with self._lock:
            bar = self._bar(name)
            bar.bar_format = None
            bar.total = max(expected, done)
            bar.n = done
            bar.refresh()
        self._begin()

    def close(self) -> None:
        """Take the bars away; those of stages still at work come back at their next step."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._ended.set()
            thread.join()
            self._ended.clear()
        with self._lock:
            self._clear()
            self._last = None

    def _clear(self) -> None:
        while self._bars:
            self._bars.popitem()[1].close()

    def _bar(self, name: str) -> tqdm[Any]:
        if name not in self._bars:
            self._bars[name] = tqdm(
                desc=f"  {name}",
                file=sys.stderr,
                leave=False,
                unit="step",
                position=len(self._bars),
                bar_format=_CLOCK,
            )
        return self._bars[name]

    def _begin(self) -> None:
        """Start the thread that moves the bars, unless it is at work."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._beat, daemon=True)
            self._thread.start()

    def _beat(self) -> None:
        while not self._ended.wait(HEARTBEAT_S):
            with self._lock:
                if self._last is not None:
                    self._bar(self._last)
                for bar in self._bars.values():
                    bar.refresh()


def result_of(out: Path) -> dict[str, Any]:
    """Return what calibration.json of a run says."""
    found: dict[str, Any] = json.loads((out / "calibration.json").read_text(encoding="utf-8"))
    return found


def summary_json(out: Path) -> tuple[dict[str, Any], bool]:
    """Return the end of a run for programs, and whether all gates passed."""
    result = result_of(out)
    failed = [gate for gate in result["gates"] if not gate["passed"]]
    selected, parameters = result.get("selected"), {}
    if selected is not None:
        fit = _adjusted(result) or result["fits"][f"{selected}/posterior"]
        parameters = fit["parameters"] | fit.get("derived", {})
    document = {
        "out": str(out),
        "dataset": result["dataset"],
        "selected": selected,
        "method": result.get("method", "rows" if selected is not None else None),
        "parameters": parameters,
        "passed": not failed,
        "failed_gates": failed,
        "diagnosis": result.get("diagnosis", []),
        "warnings": [*result.get("warnings", []), *_uncertified(out)],
    }
    return document, not failed


def faults_only(out: Path) -> tuple[str, bool]:
    """Return failed gates and warnings of a run, and whether all gates passed."""
    result = result_of(out)
    lines = _faults(result, out)
    return "\n".join(lines), all(gate["passed"] for gate in result["gates"])


def _faults(result: dict[str, Any], out: Path) -> list[str]:
    failed = [gate for gate in result["gates"] if not gate["passed"]]
    mark = painted("GATE FAILED", "red", sys.stdout)
    warning = painted("warning", "yellow", sys.stdout)
    return [
        *(_cause(cause) for cause in result.get("diagnosis", [])),
        *(f"{mark}  {gate['name']}: {gate['detail']}" for gate in failed),
        *(f"{warning}: {text}" for text in [*result.get("warnings", []), *_uncertified(out)]),
    ]


def _uncertified(out: Path) -> list[str]:
    """Return which forms of the certificate a run has not written, and why."""
    missing = tomllib.loads((out / "run.toml").read_text(encoding="utf-8")).get("certificate", {})
    words = {"missing": "no certificate", "pdf_missing": "no certificate.pdf"}
    return [f"{words[key]}: {reason}" for key, reason in missing.items() if key in words]


def summary(out: Path) -> tuple[str, bool]:
    """Return the end of a run in a few lines, and whether all gates passed."""
    result = result_of(out)
    lines = _instrument(result)
    selected = result.get("selected")
    if selected is not None:
        by = "" if _adjusted(result) is None else " of the gaze rows alone"
        lines += [
            f"selected model{by}: {selected}",
            *_estimates(result["fits"][f"{selected}/posterior"]),
        ]
    lines += _faults(result, out)
    lines.append(f"results in {harmless(str(out))}")
    return "\n".join(lines), all(gate["passed"] for gate in result["gates"])


def _instrument(result: dict[str, Any]) -> list[str]:
    """Return from what the instrument is taken, where there is a choice."""
    if "method" not in result:
        return []
    by = {"rows": "the gaze rows", "adjustment": "the adjustment of all pictures"}
    lines = [f"depths are measured by {by[result['method']]}: {result['method_rule']}"]
    adjusted = _adjusted(result)
    return lines if adjusted is None else [*lines, *_estimates(adjusted)]


def _adjusted(result: dict[str, Any]) -> dict[str, Any] | None:
    """Return the fit of the adjustment where the instrument is taken from it."""
    if result.get("method") != "adjustment":
        return None
    found: dict[str, Any] = result["fits"][f"{result['adjustment']['model']}/adjustment"]
    return found


def _estimates(fit: dict[str, Any]) -> list[str]:
    """Return the parameters of a fit and what follows from them, a line each."""
    lines, derived = [], fit.get("derived", {})
    for name, estimate in (fit["parameters"] | derived).items():
        by_prior = estimate.get("identified_by") == "prior"
        decided = " (identified by prior knowledge)" if by_prior else ""
        figures = _figures(estimate["value"], estimate["std"])
        if "q2.5" in estimate and name in derived:
            low, high = interval(estimate["q2.5"], estimate["q97.5"], uncertainty=estimate["std"])
            figures += f" (95 %: {low} to {high})"
        lines.append(f"  {name:24s} {figures}{decided}")
    return lines


def _figures(value: float, std: float) -> str:
    """Return a value with its standard uncertainty, rounded as report and certificate round."""
    if not 0 < std < math.inf:
        return f"{value:>12.5g} +- {std:.2g}"
    both = with_uncertainty(value, std)
    return f"{both.value:>12s} +- {both.uncertainty}"


def _cause(cause: dict[str, Any]) -> str:
    """Return a diagnosed cause in one line."""
    from calib.diagnosis.findings import scatter_words

    before, after = cause["noise_scale"]
    what, expected = scatter_words(cause["seen_in"])
    return (
        f"CAUSE  {cause['cause']}: {cause['text']} ({what} {before:.2g} times {expected}, "
        f"{after:.2g} with it; evidence {cause['gain']:.0f} nats)"
    )
