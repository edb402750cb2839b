"""What a diagnosis finds: mistakes tried, those named, and what to say of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.core.arrays import FloatArray
from calib.diagnosis.hypotheses import HYPOTHESES, Hypothesis
from calib.diagnosis.structure import Stretched, Structure
from calib.uncertainty.format import with_uncertainty

MATTERS = 1.0
"""Effect on a depth, in its standard uncertainties, from which a cause may not be left out."""

SeenIn = Literal["rows", "references", "both"]


def scatter_words(seen_in: SeenIn) -> tuple[str, str]:
    """Return what a cause's noise scale is of, and what it is relative to.

    Where independent references took part, it is theirs: over a scatter that the residuals of the
    rows have widened already.
    """
    if seen_in == "rows":
        return "residuals", "what is stated"
    return "errors of independent depths and lengths", "what the calibration leads to expect"


@dataclass(frozen=True)
class Attempt:
    """A hypothesis as the rows have it.

    Parameters
    ----------
    name
        Of `HYPOTHESES`.
    at
        Where it struck; None where it has no place.
    estimate, std
        Its parameter and the standard uncertainty of it, in the hypothesis' unit; NaN where it has
        none.
    gain
        Evidence for it, nats: the gain in the logarithm of the marginal likelihood, less penalties
        for hypotheses and places tried.
    seen_in
        Where the evidence is from: calibration "rows", independent "references", or "both".
    """

    name: str
    at: str | None
    estimate: float
    std: float
    gain: float
    seen_in: SeenIn = "rows"

    @property
    def hypothesis(self) -> Hypothesis:
        """Its entry in the table."""
        return HYPOTHESES[self.name]

    @property
    def text(self) -> str:
        """What it says, with its figures."""
        value = ""
        if self.std > 0:
            rounded = with_uncertainty(self.estimate, self.std)
            value = f"{rounded.value} +- {rounded.uncertainty} {self.hypothesis.unit}"
            value = value.removesuffix(" 1")
        by_rows, by_references = self.hypothesis.text, self.hypothesis.by_references
        text = by_references if self.seen_in == "references" else by_rows
        return text.format(value=value, at=self.at)


@dataclass(frozen=True, kw_only=True)
class Cause(Attempt):
    """A hypothesis that the rows speak for.

    Parameters
    ----------
    noise_scale
        Without and with it, of what `scatter_words` says.
    effect
        Largest change of a depth by it, over the depth's standard uncertainty.
    is_carried
        Whether the model has it as a parameter anyway, so that nothing is left out.
    ids
        Rows looked at.
    residual_mrad
        Theirs, without and with it, shape (2, n).
    beside
        Name of the first cause, where this is a second one that shows once that is allowed for;
        None of those that explain the rows by themselves.
    """

    noise_scale: tuple[float, float]
    effect: float
    is_carried: bool
    ids: tuple[str, ...]
    residual_mrad: FloatArray
    beside: str | None = None

    @property
    def text(self) -> str:
        """What it says, with its figures."""
        text = super().text if self.beside is None else f"beside {self.beside}, {super().text}"
        return f"{text}; the model allows for it" if self.is_carried else text


@dataclass(frozen=True)
class Suspect:
    """A hypothesis that the rows neither show nor rule out, to be held against references.

    Parameters
    ----------
    attempt
        As the rows have it.
    values, covariance
        Its parameters, shape (k,), in mm, rad or 1, and their covariance, (k, k).
    theta
        Full parameter vector beside it, shape (COUNT,).
    noise_scale
        Of the rows, without and with it.
    """

    attempt: Attempt
    values: FloatArray
    covariance: FloatArray
    theta: FloatArray
    noise_scale: tuple[float, float]

    @property
    def relative_std(self) -> float:
        """Standard uncertainty of its size over its size; 0 of what has no size."""
        size = float(np.sqrt(self.values @ self.values))
        if size == 0:
            return 0.0
        return float(np.sqrt(self.values @ self.covariance @ self.values)) / size**2


@dataclass(frozen=True)
class Diagnosis:
    """What explains the rows better than the model alone.

    Parameters
    ----------
    model
        Model of the fit that was diagnosed.
    causes
        Those named, best first: by the rows, all of which fit nearly as well; those that show
        beside the first of them; by independent references.
    tried
        All that were tried and that the rows can tell something of, best first.
    structure
        Tests of the residuals of the model alone.
    stretched
        Parameters whose estimates lie far out in their priors.
    suspects
        For the stage that has independent references; none are left by it.
    """

    model: str
    causes: tuple[Cause, ...] = ()
    tried: tuple[Attempt, ...] = ()
    structure: tuple[Structure, ...] = ()
    stretched: tuple[Stretched, ...] = ()
    suspects: tuple[Suspect, ...] = ()

    @property
    def left_out(self) -> Cause | None:
        """The first cause that the model does not allow for and that matters for depths."""
        found = [cause for cause in self.causes if self.matters(cause)]
        return found[0] if found else None

    def others(self, cause: Cause) -> tuple[str, ...]:
        """Return the names of causes that explain the same data about as well as one of them."""
        same = [
            other
            for other in self.causes
            if (other.seen_in == "rows", other.beside) == (cause.seen_in == "rows", cause.beside)
        ]
        return tuple(other.name for other in same if other.name != cause.name)

    def words(self, cause: Cause) -> str:
        """Return what a cause says, its remedy and what else it may be."""
        text = f"{cause.name}: {cause.text}; {cause.hypothesis.remedy}"
        if others := self.others(cause):
            either = [f"{name} ({HYPOTHESES[name].remedy})" for name in others]
            text += f". As well it may be {' or '.join(either)}: {cause.hypothesis.tells}"
        for other in self.causes:
            if other.beside == cause.name:
                text += f". {other.name}: {other.text}; {other.hypothesis.remedy}"
        return text

    def matters(self, cause: Cause) -> bool:
        """Whether leaving a cause out moves a depth by more than its u."""
        return not cause.is_carried and cause.effect > MATTERS
