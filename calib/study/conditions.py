"""What the rigs of a study have in common: size, noise, outliers, and what is stated wrongly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from calib.core.errors import UsageError

ROW_COUNTS = (6, 14, 60)
"""The least that the extended model accepts, the paper's Table 1, and a day's work."""

OUTLIER_SHARE = 0.1


@dataclass(frozen=True)
class Condition:
    """Conditions under which rigs are simulated and calibrated.

    Parameters
    ----------
    name
        Key in tables; stable.
    meaning
        One phrase for figures and documents.
    model
        Model that the rigs are drawn from.
    fitted
        Models that are fitted and among which one is selected.
    rows
        Calibration rows a rig.
    outlier_share
        Probability of a row to carry a gross error.
    coarse
        Whether the encoder's count is by far the largest error.
    stated_factor
        Stated over true standard uncertainties of the rows.
    prior_factor
        Stated over true standard deviations of the parameters' priors.
    shared_z_rel
        Standard deviation of the error that all reference depths have in common, relative.
    shared_stated
        Whether the calibration is told of it.
    z_rel
        Each reference depth's own error, relative; None for that of the drawn rig.
    from_priors
        Whether all parameters and the noise scale are drawn from proper priors which are stated:
        the ranks of the truth in its posteriors must then be uniform (Talts et al. 2018,
        arXiv 1804.06788).
    """

    name: str
    meaning: str
    model: str = "axis-offset"
    fitted: tuple[str, ...] = ("base", "axis-offset")
    rows: int = 14
    outlier_share: float = 0.0
    coarse: bool = False
    stated_factor: float = 1.0
    prior_factor: float = 1.0
    shared_z_rel: float = 0.0
    shared_stated: bool = True
    z_rel: float | None = None
    from_priors: bool = False


def _grid() -> list[Condition]:
    """Return both models at all sizes, with and without outliers."""
    return [
        Condition(
            f"{model}-{rows}{'-outliers' if share else ''}",
            f"{model}, {rows} rows{', 10 % gross errors' if share else ''}",
            model=model,
            rows=rows,
            outlier_share=share,
        )
        for model in ("base", "axis-offset")
        for share in (0.0, OUTLIER_SHARE)
        for rows in ROW_COUNTS
    ]


def _ranked() -> list[Condition]:
    return [
        Condition(
            f"ranks-{model}",
            f"{model}, 14 rows, truth and noise scale from the priors",
            model=model,
            fitted=(model,),
            from_priors=True,
        )
        for model in ("base", "axis-offset")
    ]


_BROKEN = [
    Condition("coarse-6", "6 rows, quantisation dominates", rows=6, coarse=True),
    Condition("coarse-14", "14 rows, quantisation dominates", coarse=True),
    Condition("stated-half", "uncertainties stated at half", stated_factor=0.5),
    Condition("stated-double", "uncertainties stated at twice", stated_factor=2.0),
    Condition("prior-third", "priors stated at a third", prior_factor=1 / 3),
    Condition("prior-triple", "priors stated at three times", prior_factor=3.0),
    Condition("reference-rough", "reference depths to 1 %, stated", z_rel=0.01),
    Condition("reference-shared", "reference scale off by 0.5 %, stated", shared_z_rel=0.005),
    Condition(
        "reference-hidden", "reference scale off by 0.5 %, not stated",
        shared_z_rel=0.005, shared_stated=False,
    ),
    Condition("encoder-bent", "rigs have encoder errors, not modelled", model="encoder"),
    Condition("axis-tilted", "rigs have tilted axes, not modelled", model="axis-tilt"),
]  # fmt: skip

CONDITIONS: Mapping[str, Condition] = MappingProxyType(
    {condition.name: condition for condition in (*_grid(), *_ranked(), *_BROKEN)}
)

ADVICE = "advice"
"""Name of the trials that compare advised with random targets; see `calib.study.advice`."""

MISTAKES = "faults"
"""Name of the trials of what labs do wrong; see `calib.study.faults`."""

GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "default": tuple(c.name for c in _grid()),
        "ranks": tuple(c.name for c in _ranked()),
        "broken": tuple(c.name for c in _BROKEN),
        "all": (*CONDITIONS, ADVICE, MISTAKES),
    }
)


def chosen(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the conditions that names of conditions or groups stand for, each once.

    Raises
    ------
    UsageError
        If a name is neither.
    """
    found: dict[str, None] = {}
    for name in names:
        if name not in GROUPS and name not in (*CONDITIONS, ADVICE, MISTAKES):
            known = ", ".join([*GROUPS, *CONDITIONS, ADVICE, MISTAKES])
            raise UsageError(f"--condition {name}: unknown; choose from {known}")
        found |= dict.fromkeys(GROUPS.get(name, (name,)))
    return tuple(found)
