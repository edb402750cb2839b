"""Results on disk: atomic files, and stage results that are reused while nothing has changed."""

from __future__ import annotations

import fcntl
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from calib.core.errors import UsageError
from calib.stages.call import address, call_stage, result_type
from calib.stages.files import (
    CACHE,
    IN_USE,
    LOCK,
    cannot_write,
    clear_partial,
    opened_lock,
    write_bytes,
)
from calib.stages.parallel import Request, processors, run_parallel
from calib.stages.stage_file import Failure, is_intact, pack, read, with_header
from calib.stages.step import Staged, Step, gather, given, optional, stage

__all__ = [
    "Staged",
    "Step",
    "Store",
    "gather",
    "given",
    "optional",
    "stage",
]

T = TypeVar("T")


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
            raise cannot_write(self.out, error) from error

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep every other run out of the folder; the lock dies with the process.

        Raises
        ------
        UsageError
            If another run holds it.
        """
        with opened_lock(self.out / LOCK) as handle:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise UsageError(
                    f"{self.out}: {IN_USE}; wait for it or choose another --out"
                ) from None
            self._clear_away()
            yield

    def _clear_away(self) -> None:
        """Delete what runs that were killed left half-written."""
        for folder in (self.out, self.out / CACHE):
            clear_partial(folder)

    def run_all(
        self, steps: Mapping[str, Step[T]], *, side_by_side: bool = True
    ) -> dict[str, Staged[T]]:
        """Return the outcomes of stages that do not need each other, by the keys of `steps`.

        Parameters
        ----------
        side_by_side
            Whether they take so long that a process of its own is worth its start: then they are
            computed at the same time, as far as there are processors.
        """
        missing = [s for s in steps.values() if not self._has(s) and s.failed is None]
        workers = min(len(missing), processors()) if side_by_side else 1
        if workers > 1:
            self._run_workers(missing, workers)
        return {key: self.run(step) for key, step in steps.items()}

    def run(self, step: Step[T]) -> Staged[T]:
        """Return the outcome of a stage, reused, or computed here and now if there is none."""
        if self._has(step):
            if step.name not in self.durations:
                self.reused.append(step.name)
            path, kind = self._path(step), result_type(step.function)
            return Staged(step.name, step.fingerprint, lambda: read(path, kind))
        started = self._announced(step.name)
        outcome = (
            call_stage(step.function, step.name, step.values(), step.settings, self.progress)
            if step.failed is None
            else Failure(step.failed)
        )
        self._keep(step, pack(outcome), started)
        return Staged(step.name, step.fingerprint, lambda: outcome)

    def _run_workers(self, steps: Sequence[Step[Any]], workers: int) -> None:
        """Compute steps in processes of their own and keep each outcome as it comes."""
        by_name = {step.name: step for step in steps}
        starts: dict[str, float] = {}

        def started(name: str) -> None:
            starts[name] = self._announced(name)

        requests = [
            Request(s.name, address(s.function), tuple(map(pack, s.values())), s.settings)
            for s in steps
        ]
        outcomes = run_parallel(requests, workers=workers, started=started, progress=self.progress)
        with closing(outcomes):
            for name, content in outcomes:
                self._keep(by_name[name], content, starts[name])

    def _announced(self, name: str) -> float:
        self.announce(name)
        return time.perf_counter()

    def _path(self, step: Step[Any]) -> Path:
        return self.out / CACHE / (step.name.replace("/", "--") + ".h5")

    def _has(self, step: Step[Any]) -> bool:
        return is_intact(self._path(step), step.fingerprint)

    def _keep(self, step: Step[Any], content: bytes, started: float) -> None:
        write_bytes(self._path(step), with_header(step.fingerprint, content))
        self.durations[step.name] = time.perf_counter() - started
