"""Results on disk: atomic files, and stage results that are reused while nothing has changed.

A stage result is a frozen dataclass. Its numbers, texts and structure go into one JSON document,
its arrays into HDF5 datasets beside it; reading checks every type against the dataclass. Nothing
read is ever evaluated.
"""

from __future__ import annotations

import fcntl
import importlib
import inspect
import json
import os
import tempfile
import time
import typing
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar

import h5py
import numpy as np
from cattrs.errors import BaseValidationError, ForbiddenExtraKeysError
from numpy.random import SeedSequence

from calib.codec import put_together, take_apart
from calib.errors import CalibError, EstimationError, UsageError
from calib.fingerprint import code_fingerprint, digest
from calib.hdf5 import hdf5_arrays, hdf5_bytes

CACHE = ".stages"
LOCK = ".lock"
DOCUMENT = "document"
PARTIAL = ".part"

_UNREADABLE = (
    OSError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    RecursionError,
    BaseValidationError,
    ForbiddenExtraKeysError,
)

T = TypeVar("T")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; on success it takes that name, else it vanishes.

    Raises
    ------
    UsageError
        If the file cannot be written: no space, no permission.
    """
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=PARTIAL, dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise _cannot_write(path, error) from error
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def _cannot_write(path: Path, error: OSError) -> UsageError:
    reason = error.strerror or str(error)
    return UsageError(f"{path}: cannot be written ({reason}); free space or choose another --out")


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file so that its name never stands for half of it."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)


@dataclass(frozen=True)
class Failure:
    """The outcome of a stage that has no answer on its data."""

    reason: str


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


def _input_value(source: Input) -> Any:
    if isinstance(source, Mapping):
        return {name: staged.value for name, staged in source.items()}
    return None if source is None else source.value


@dataclass
class Store:
    """The folder of one run's results.

    Parameters
    ----------
    out
        The folder; made if it is not there.
    announce
        Told the name of each stage that is about to run.
    progress
        Told how far a long stage is: name, steps done, steps expected.
    """

    out: Path
    announce: Callable[[str], None] = lambda _: None
    progress: Callable[[str, int, int], None] = lambda *_: None
    durations: dict[str, float] = field(default_factory=dict)
    reused: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        try:
            (self.out / CACHE).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _cannot_write(self.out, error) from error

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep every other run out of the folder; the lock dies with the process.

        Raises
        ------
        UsageError
            If another run holds it.
        """
        try:
            handle = (self.out / LOCK).open("w")
        except OSError as error:
            raise _cannot_write(self.out / LOCK, error) from error
        with handle:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise UsageError(
                    f"{self.out}: another run is writing there; wait for it or choose another --out"
                ) from None
            self._clear_away()
            yield

    def _clear_away(self) -> None:
        """Delete what runs that were killed left half-written."""
        for folder in (self.out, self.out / CACHE):
            for left in folder.glob(f".*{PARTIAL}"):
                left.unlink(missing_ok=True)

    def stage(self, name: str, target: str, *inputs: Input, **settings: Any) -> Staged[Any]:
        """Return the outcome of a stage, computed now or reused.

        Parameters
        ----------
        name
            Key of the result, with slashes.
        target
            ``module:function``; imported only if the stage has to run. The function's return
            annotation is the type that is stored.
        inputs
            Passed by position; a mapping of stages as a mapping of their values.
        settings
            JSON-able; passed by keyword. A setting ``seed`` arrives as a SeedSequence that no
            other stage shares; a function that takes ``progress`` gets the store's.
        """
        module, function = target.split(":")
        fingerprint = digest(
            name,
            function,
            code_fingerprint(module),
            [_input_fingerprint(i) for i in inputs],
            settings,
        )
        path = self.out / CACHE / (name.replace("/", "--") + ".h5")
        if _is_intact(path, fingerprint):
            self.reused.append(name)
            return Staged(name, fingerprint, lambda: _read(path, _result_type(target)))
        self.announce(name)
        started = time.perf_counter()
        outcome = self._run(target, name, inputs, settings)
        _write(path, fingerprint, outcome)
        self.durations[name] = time.perf_counter() - started
        return Staged(name, fingerprint, lambda: outcome)

    def _run(
        self, target: str, name: str, inputs: tuple[Input, ...], settings: Mapping[str, Any]
    ) -> Any:
        function, arguments = _function(target), dict(settings)
        if "seed" in arguments:
            arguments["seed"] = SeedSequence(arguments["seed"], spawn_key=tuple(name.encode()))
        if "progress" in inspect.signature(function).parameters:
            arguments["progress"] = partial(self.progress, name)
        try:
            return function(*map(_input_value, inputs), **arguments)
        except EstimationError as error:
            return Failure(str(error))


def _function(target: str) -> Callable[..., Any]:
    module, name = target.split(":")
    function: Callable[..., Any] = getattr(importlib.import_module(module), name)
    return function


def _result_type(target: str) -> Any:
    return typing.get_type_hints(_function(target))["return"]


SEAL_BYTES = 512
"""Before the HDF5 part of a stage file stands its seal; HDF5 allows for 512 bytes."""

_SEAL = "calib stage 1\n{fingerprint}\n{sha256}\n"


def _seal(fingerprint: str, content: bytes) -> bytes:
    text = _SEAL.format(fingerprint=fingerprint, sha256=sha256(content).hexdigest())
    return text.encode().ljust(SEAL_BYTES, b"\0")


def _is_intact(path: Path, fingerprint: str) -> bool:
    """Return whether a stage file is there, has this fingerprint and is as it was written."""
    try:
        content = path.read_bytes()
    except OSError:
        return False
    return content[:SEAL_BYTES] == _seal(fingerprint, content[SEAL_BYTES:])


def _write(path: Path, fingerprint: str, outcome: Any) -> None:
    document, arrays = take_apart(outcome)
    text = json.dumps([isinstance(outcome, Failure), document], ensure_ascii=False).encode()

    def fill(file: h5py.File) -> None:
        for key, array in arrays.items():
            file.create_dataset(key, data=array)
        file.create_dataset(DOCUMENT, data=np.frombuffer(text, np.uint8))

    content = hdf5_bytes(fill)
    write_bytes(path, _seal(fingerprint, content) + content)


def _read(path: Path, kind: Any) -> Any:
    try:
        arrays = dict(hdf5_arrays(path.read_bytes()[SEAL_BYTES:]))
        failed, document = json.loads(arrays.pop(DOCUMENT).tobytes().decode())
        return put_together(document, arrays, Failure if failed is True else kind)
    except _UNREADABLE as error:
        raise CalibError(f"{path}: damaged ({error}); delete it and run again") from error
