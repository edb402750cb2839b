"""A stage as it is asked for and as it comes out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from inspect import signature
from typing import Any, Concatenate, Generic, TypeVar, overload

from calib.core.errors import EstimationError
from calib.stages.fingerprint import code_fingerprint, digest
from calib.stages.serialise import serialise
from calib.stages.stage_file import Failure

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


@dataclass
class Staged(Generic[T_co]):
    """A stage's outcome: its fingerprint now, its value when it is asked for."""

    name: str
    fingerprint: str
    _load: Callable[[], T_co | Failure]
    _loaded: list[T_co | Failure] = field(default_factory=list)

    @property
    def outcome(self) -> T_co | Failure:
        """The value, or why there is none."""
        if not self._loaded:
            self._loaded.append(self._load())
        return self._loaded[0]

    @property
    def value(self) -> T_co:
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

    def get(self) -> T_co | None:
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
    document, arrays = serialise(value)
    contents = {
        key: [str(a.dtype), a.shape, sha256(a.tobytes()).hexdigest()] for key, a in arrays.items()
    }
    return Staged(name, digest(document, contents), lambda: value)


def gather(stages: Mapping[str, Staged[T]]) -> Staged[Mapping[str, T]]:
    """Return stages of one kind, by name, as one input."""
    failed = next((s for s in stages.values() if s.failed is not None), None)

    def values() -> Mapping[str, T] | Failure:
        if failed is not None:
            return Failure(str(failed.failed))
        return {name: stage.value for name, stage in stages.items()}

    return Staged("gathered", digest({n: s.fingerprint for n, s in stages.items()}), values)


def optional(stage: Staged[T] | None) -> Staged[T | None]:
    """Return an input that a dataset may have no data for; its value is None then."""
    return Staged("absent", digest(None), lambda: None) if stage is None else stage


@dataclass(frozen=True)
class Step(Generic[T]):
    """A stage to come; `stage` makes one.

    Parameters
    ----------
    name
        Key of the result, with slashes.
    function
        A public function of a module, so that a process of its own can import it too. Its
        annotations are the types in which inputs and result are stored.
    inputs
        Passed by position.
    settings
        JSON-able; passed by keyword. A setting ``seed`` arrives as a SeedSequence that no other
        stage shares; a function that takes ``progress`` gets the store's.
    """

    name: str
    function: Callable[..., T]
    inputs: tuple[Staged[Any], ...]
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # Also where the outcome is reused: a misspelt setting must not wait for a change of data.
        called = signature(self.function)
        from_store = {"progress"} & called.parameters.keys()
        called.bind(*self.inputs, **self.settings, **dict.fromkeys(from_store))

    @cached_property
    def fingerprint(self) -> str:
        """Of all that the outcome depends on: inputs, settings and the code of the stage."""
        sources = [source.fingerprint for source in self.inputs]
        code = code_fingerprint(self.function.__module__)
        return digest(self.name, self.function.__qualname__, code, sources, dict(self.settings))

    @property
    def failed(self) -> str | None:
        """Why an input has no value, and so no outcome can be computed, or None."""
        return next((s.failed for s in self.inputs if s.failed is not None), None)

    def values(self) -> list[Any]:
        """Return the values of the inputs; none may have failed."""
        return [source.value for source in self.inputs]


A = TypeVar("A")
B = TypeVar("B")
C = TypeVar("C")
D = TypeVar("D")
E = TypeVar("E")
F = TypeVar("F")
G = TypeVar("G")
H = TypeVar("H")
J = TypeVar("J")


# fmt: off
@overload
def stage(name: str, function: Callable[Concatenate[A, ...], T], a: Staged[A], /,
          **settings: Any) -> Step[T]: ...
@overload
def stage(name: str, function: Callable[Concatenate[A, B, ...], T], a: Staged[A], b: Staged[B], /,
          **settings: Any) -> Step[T]: ...
@overload
def stage(name: str, function: Callable[Concatenate[A, B, C, ...], T],
          a: Staged[A], b: Staged[B], c: Staged[C], /, **settings: Any) -> Step[T]: ...
@overload
def stage(name: str, function: Callable[Concatenate[A, B, C, D, ...], T],
          a: Staged[A], b: Staged[B], c: Staged[C], d: Staged[D], /,
          **settings: Any) -> Step[T]: ...
@overload
def stage(name: str, function: Callable[Concatenate[A, B, C, D, E, ...], T],
          a: Staged[A], b: Staged[B], c: Staged[C], d: Staged[D], e: Staged[E], /,
          **settings: Any) -> Step[T]: ...
@overload
def stage(name: str, function: Callable[Concatenate[A, B, C, D, E, F, ...], T],
          a: Staged[A], b: Staged[B], c: Staged[C], d: Staged[D], e: Staged[E], f: Staged[F], /,
          **settings: Any) -> Step[T]: ...
@overload
def stage(name: str, function: Callable[Concatenate[A, B, C, D, E, F, G, ...], T],
          a: Staged[A], b: Staged[B], c: Staged[C], d: Staged[D], e: Staged[E], f: Staged[F],
          g: Staged[G], /, **settings: Any) -> Step[T]: ...
@overload
def stage(name: str, function: Callable[Concatenate[A, B, C, D, E, F, G, H, ...], T],
          a: Staged[A], b: Staged[B], c: Staged[C], d: Staged[D], e: Staged[E], f: Staged[F],
          g: Staged[G], h: Staged[H], /, **settings: Any) -> Step[T]: ...
@overload
def stage(name: str, function: Callable[Concatenate[A, B, C, D, E, F, G, H, J, ...], T],
          a: Staged[A], b: Staged[B], c: Staged[C], d: Staged[D], e: Staged[E], f: Staged[F],
          g: Staged[G], h: Staged[H], j: Staged[J], /, **settings: Any) -> Step[T]: ...
# fmt: on
def stage(
    name: str, function: Callable[..., T], /, *inputs: Staged[Any], **settings: Any
) -> Step[T]:
    """Return a stage to come; for the parameters see `Step`.

    The overloads let a type checker hold each input against the function's parameter of the same
    position: one for each number of inputs, as the type system has no other way of saying so.
    """
    return Step(name, function, inputs, settings)
