"""A batch from its datasets to their outcomes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from calib.batch.task import Children, DatasetTask, Outcome, calibrate_one
from calib.core.errors import UsageError
from calib.stages.cluster import run_on_cluster


def refuse_absent(datasets: Sequence[Path]) -> None:
    """Raise where a dataset is not there at all, as when a pattern of the shell matches nothing.

    Raises
    ------
    UsageError
        With the first of them.
    """
    absent = [str(path) for path in datasets if not path.exists()]
    if absent:
        more = f" and {len(absent) - 1} more" if len(absent) > 1 else ""
        raise UsageError(f"{absent[0]}{more}: not there; give folders with a dataset.toml")


def tasks_of(
    datasets: Sequence[Path], out: Path, *, seed: int = 0, force: bool = False
) -> tuple[DatasetTask, ...]:
    """Return one task a dataset; its run goes into a folder of `out` named after it.

    Datasets of one name get their parents' names before it.

    Raises
    ------
    UsageError
        If two runs would still share a folder.
    """
    real = [path.resolve() for path in datasets]
    names = Counter(path.name for path in real)
    found: dict[str, Path] = {}
    for path in real:
        name = path.name if names[path.name] == 1 else f"{path.parent.name}-{path.name}"
        if name in found and found[name] == path:
            raise UsageError(f"{path}: is given twice")
        if name in found:
            raise UsageError(
                f"{found[name]} and {path}: would both go to {out / name}; calibrate one of them "
                "in a batch of its own with another --out"
            )
        found[name] = path
    where = out.resolve()
    return tuple(
        DatasetTask(str(path), str(where / name), seed, force) for name, path in found.items()
    )


def run_batch(
    tasks: Sequence[DatasetTask],
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    finished: Callable[[Outcome], None] = lambda _: None,
) -> tuple[Outcome, ...]:
    """Return the outcomes in the order of the tasks.

    Parameters
    ----------
    jobs
        Datasets at a time on this machine, a processor each.
    scheduler
        Address of a Dask scheduler to work on instead, whose workers see the same folders.
    finished
        Told each outcome as it comes.

    Raises
    ------
    UsageError
        If the cluster cannot be reached.
    EstimationError
        If workers of the cluster die again and again.
    """
    found: dict[DatasetTask, Outcome] = {}
    outcomes = (
        _here(tasks, jobs) if scheduler is None else run_on_cluster(calibrate_one, tasks, scheduler)
    )
    for outcome in outcomes:
        found[outcome.task] = outcome
        finished(outcome)
    return tuple(found[task] for task in tasks)


def _here(tasks: Sequence[DatasetTask], jobs: int) -> Iterator[Outcome]:
    """Yield outcomes as they come; each thread waits for a process."""
    children = Children()
    with ThreadPoolExecutor(max_workers=min(jobs, len(tasks))) as pool:
        futures = [pool.submit(calibrate_one, task, children) for task in tasks]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            children.end()
            raise
