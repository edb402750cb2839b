"""Priors that the rows contradict: named, before rows or model get the blame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from calib.fit.priors import NOISE_SCALE
from calib.geometry.parameters import INDEX, PARAMETERS
from calib.results.calibration import GazeResult

STRETCHED = 2.5
"""Standard deviations of its prior that an estimate may be off: beyond, 1 in 80 is by chance."""


def prior_warnings(gaze: GazeResult, stated: Mapping[str, tuple[float, float]]) -> Iterator[str]:
    """Yield a warning for each parameter that stretches its prior, or each scaled default.

    Parameters
    ----------
    stated
        Mean and standard deviation by parameter, as the manifest gives them.
    """
    if gaze.comparison is None:
        return
    model = gaze.comparison.selected
    fit = gaze.robust[model]
    for name, value in zip(fit.names, fit.values, strict=True):
        prior = stated.get(name) or gaze.default_priors.get(name) or _default(name)
        if prior is None or name == NOISE_SCALE:
            continue
        mean, std = prior
        off = abs(float(value) - mean) / std
        if off > STRETCHED:
            whose = "the manifest's" if name in stated else "the default"
            unit = PARAMETERS[INDEX[name]].unit.replace("1", "")
            yield (
                f"prior stretched: the rows put {name} at {value:.3g} {unit}".rstrip()
                + f", {off:.1f} standard deviations from {whose} prior, {mean:.3g} +- {std:.2g}. "
                f"If the rig is so, state [priors] {name} = [{value:.2g}, ...] with an uncertainty "
                "of your own; if not, something in the rows imitates it"
            )
    if gaze.default_priors:
        widths = ", ".join(f"{n} {std:.3g}" for n, (_, std) in gaze.default_priors.items())
        yield (
            "default priors are scaled to the baseline, which lies outside 60 to 400 mm "
            f"(standard deviations: {widths}); state [priors] if you know better"
        )


def _default(name: str) -> tuple[float, float] | None:
    std = PARAMETERS[INDEX[name]].prior_std
    return None if std is None or not np.isfinite(std) else (0.0, std)
