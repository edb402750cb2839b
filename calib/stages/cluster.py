"""Work spread over a Dask cluster that somebody else has started."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from calib.core.errors import EstimationError, UsageError

RETRIES = 3
"""Times that a task is given to another worker after one has died over it."""

CONNECT_SECONDS = 10
"""Longest wait for a scheduler to answer."""

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


def run_on_cluster(
    work: Callable[[_Task], _Result], tasks: Sequence[_Task], address: str
) -> Iterator[_Result]:
    """Yield what `work` returns of each task, in the order in which they are finished.

    Parameters
    ----------
    work
        A function of a module that the workers have, in the same version.
    address
        Of the Dask scheduler.

    Raises
    ------
    UsageError
        If the cluster cannot be reached.
    EstimationError
        If several workers die over one task.
    """
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise UsageError(
            "--scheduler needs the package distributed: pip install 'active-gazing-calib[cluster]'"
        ) from error
    try:
        client = distributed.Client(address, timeout=CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        raise UsageError(
            f"--scheduler {address}: no Dask scheduler answers there; start one with "
            "`dask scheduler` and workers with `dask worker ADDRESS`"
        ) from error
    with client:
        # Keys of their own: a task asked for twice, by two clients, is still computed afresh.
        futures = client.map(work, tasks, pure=False, retries=RETRIES)
        try:
            for future in distributed.as_completed(futures):
                yield future.result()
        except distributed.KilledWorker as error:
            raise EstimationError(
                f"workers died over one task {RETRIES} times; what was finished is kept: look at "
                "the workers' memory and run the same command again"
            ) from error
