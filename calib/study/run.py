"""A study from its settings to its records; finished rigs are taken from the journal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from calib.study.journal import open_journal
from calib.study.tasks import StudyTask, key_of, perform_all

Record = dict[str, Any]


def run_study(
    journal_path: Path,
    conditions: Sequence[str],
    *,
    rigs: int,
    seed: int,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Record, ...]:
    """Return the records of rigs 0 to `rigs` - 1 of each condition, in that order.

    Parameters
    ----------
    journal_path
        Finished rigs are kept there, and those found there are not computed again.
    jobs, scheduler
        Who works: see `calib.study.tasks.perform_all`.
    progress
        Told how many rigs are done, and of how many.

    Raises
    ------
    UsageError
        If the journal or the cluster cannot be used.
    CalibError
        If a worker dies; what was finished is kept.
    """
    # Rig by rig, so that an unfinished study has all conditions to the same depth.
    tasks = [
        StudyTask(condition, seed, number, key_of(condition, seed))
        for number in range(rigs)
        for condition in conditions
    ]
    with open_journal(journal_path) as journal:
        known = journal.records()
        missing = [task for task in tasks if (task.key, task.number) not in known]
        done = len(tasks) - len(missing)
        for record in perform_all(missing, jobs=jobs, scheduler=scheduler):
            journal.add(record)
            known[record["key"], record["number"]] = record
            done += 1
            if progress is not None:
                progress(done, len(tasks))
    return tuple(known[task.key, task.number] for task in tasks)
