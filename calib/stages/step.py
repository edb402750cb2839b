"""A stage as it is asked for and as it comes out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from typing import Any, Generic, TypeAlias, TypeVar

from calib.core.errors import EstimationError
from calib.stages.fingerprint import code_fingerprint, digest
from calib.stages.serialise import take_apart
from calib.stages.stage_file import Failure

T = TypeVar("T")


@dataclass
class Staged(Generic[T]):
    """A stage's outcome: its fingerprint now, its value when it is asked for."""

    name: str
    fingerprint: str
    _load: Callable[[], T | Failure]
    _loaded: list[T | Failure] = field(default_factory=list)

    @property
    def outcome(self) -> T | Failure:
        """The value, or why there is none."""
        if not self._loaded:
            self._loaded.append(self._load())
        return self._loaded[0]

    @property
    def value(self) -> T:
        """The value.

        Raises
        ------
        EstimationError
            If the stage failed.
        """
        outcome = self.outcome
        if isinstance(outcome, Failure):
            raise EstimationError(outcome.reason)
        return outcome

    def get(self) -> T | None:
        """Return the value, or None if the stage failed."""
        outcome = self.outcome
        return None if isinstance(outcome, Failure) else outcome

    @property
    def failed(self) -> str | None:
        """Why there is no value, or None."""
        outcome = self.outcome
        return outcome.reason if isinstance(outcome, Failure) else None


def given(name: str, value: T) -> Staged[T]:
    """Return a dataclass that no stage computed, e.g. a table, as a stage's input."""
    document, arrays = take_apart(value)
    contents = {
        key: [str(a.dtype), a.shape, sha256(a.tobytes()).hexdigest()] for key, a in arrays.items()
    }
    return Staged(name, digest(document, contents), lambda: value)


Input: TypeAlias = Staged[Any] | Mapping[str, Staged[Any]] | None


def _input_fingerprint(source: Input) -> Any:
    if isinstance(source, Mapping):
        return {name: staged.fingerprint for name, staged in source.items()}
    return None if source is None else source.fingerprint


def _input_failed(source: Input) -> str | None:
    if isinstance(source, Mapping):
        return next((s.failed for s in source.values() if s.failed is not None), None)
    return None if source is None else source.failed


def _input_value(source: Input) -> Any:
    if isinstance(source, Mapping):
        return {name: staged.value for name, staged in source.items()}
    return None if source is None else source.value


@dataclass(frozen=True)
class Step:
    """A stage to come.

    Parameters
    ----------
    name
        Key of the result, with slashes.
    target
        ``module:function``; imported only if the stage has to run. The function's annotations are
        the types in which inputs and result are stored.
    inputs
        Passed by position; a mapping of stages as a mapping of their values.
    settings
        JSON-able; passed by keyword. A setting ``seed`` arrives as a SeedSequence that no other
        stage shares; a function that takes ``progress`` gets the store's.
    """

    name: str
    target: str
    inputs: tuple[Input, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def fingerprint(self) -> str:
        """Of all that the outcome depends on: inputs, settings and the code of the stage."""
        module, function = self.target.split(":")
        sources = [_input_fingerprint(source) for source in self.inputs]
        code = code_fingerprint(module)
        return digest(self.name, function, code, sources, dict(self.settings))

    @property
    def failed(self) -> str | None:
        """Why an input has no value, and so no outcome can be computed, or None."""
        return next((f for source in self.inputs if (f := _input_failed(source)) is not None), None)

    def values(self) -> list[Any]:
        """Return the values of the inputs; none may have failed."""
        return [_input_value(source) for source in self.inputs]
