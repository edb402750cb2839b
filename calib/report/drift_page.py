"""Runs side by side, as text and as an HTML page."""

from __future__ import annotations

import base64
import io

from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from calib.drift import Change, Drift, RunSummary
from calib.uncertainty.format import with_uncertainty


def drift_text(drift: Drift) -> str:
    """Return the comparison for a terminal."""
    lines = [f"model {drift.model}; changes are against {drift.runs[0].label}"]
    for i, name in enumerate(drift.names):
        lines.append(f"{name} ({drift.units[i]})")
        lines += [
            f"  {run.label:32s} {_estimate(run, i)}{_verdict(drift, run, name)}"
            for run in drift.runs
        ]
    for run, probability in zip(drift.runs[1:], drift.joint, strict=True):
        lines.append(f"all together, {run.label}: p = {probability:.2g} if nothing had changed")
    for run in drift.runs:
        state = "" if run.passed else "; a gate of this run failed"
        lines.append(f"{run.label}: selected {run.selected}, {_scores(run)}{state}")
    return "\n".join(lines)


def _estimate(run: RunSummary, i: int) -> str:
    rounded = with_uncertainty(float(run.values[i]), float(run.std[i]))
    return f"{rounded.value} ± {rounded.uncertainty}"


def _change(drift: Drift, run: RunSummary, name: str) -> Change | None:
    return next((c for c in drift.changes if c.run == run.label and c.name == name), None)


def _verdict(drift: Drift, run: RunSummary, name: str) -> str:
    change = _change(drift, run, name)
    if change is None:
        return ""
    mark = "  SIGNIFICANT" if change.significant else ""
    return f"   changed by {change.sigmas:+.1f} sigma{mark}"


def _scores(run: RunSummary) -> str:
    found = [
        (run.loo, "LOO {:.1f}"),
        (None if run.cv_depth_rms_rel is None else 100 * run.cv_depth_rms_rel, "left-out {:.2g} %"),
        (
            None if run.validation_depth_rms_rel is None else 100 * run.validation_depth_rms_rel,
            "validation {:.2g} %",
        ),
    ]
    scores = [form.format(value) for value, form in found if value is not None]
    if run.depths:
        z, u = run.depths[len(run.depths) // 2]
        scores.append(f"u(z) {u:.2g} mm at {z:.0f} mm")
    return ", ".join(scores)


def drift_page(drift: Drift) -> str:
    """Return the comparison as one self-contained HTML file."""
    environment = Environment(
        loader=PackageLoader("calib.report"), autoescape=True, undefined=StrictUndefined
    )
    rows = [
        {
            "name": name,
            "unit": drift.units[i],
            "cells": [
                {"estimate": _estimate(run, i), "change": _change(drift, run, name)}
                for run in drift.runs
            ],
        }
        for i, name in enumerate(drift.names)
    ]
    return environment.get_template("drift.html.j2").render(
        drift=drift,
        rows=rows,
        scores=[_scores(run) for run in drift.runs],
        joint=[None, *drift.joint],
        figure=base64.b64encode(_figure(drift)).decode(),
    )


def _figure(drift: Drift) -> bytes:
    """Return an SVG: each parameter's 95 % intervals, run by run."""
    count = len(drift.names)
    figure = Figure(figsize=(8.0, 0.6 + 0.45 * count * max(1, len(drift.runs) / 3)))
    axes = figure.subplots(count, 1, squeeze=False)[:, 0]
    for i, ax in enumerate(axes):
        values = [float(run.values[i]) for run in drift.runs]
        half = [1.96 * float(run.std[i]) for run in drift.runs]
        ax.errorbar(values, range(len(values)), xerr=half, fmt="o", color="#0b5394", capsize=2)
        ax.set_yticks([])
        ax.set_ylim(len(values) - 0.5, -0.5)
        ax.set_title(f"{drift.names[i]} / {drift.units[i]}", fontsize=8, loc="left")
        ax.tick_params(labelsize=7)
    figure.subplots_adjust(left=0.03, right=0.97, top=0.96, bottom=0.05, hspace=1.3)
    text = io.BytesIO()
    FigureCanvasSVG(figure).print_figure(text, metadata={"Date": None})
    return text.getvalue()
