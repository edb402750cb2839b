"""The unit of work of a study, and who does it: this process, others here, or a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from typing import Any

from calib.core.errors import EstimationError
from calib.stages.call import address
from calib.stages.cluster import run_on_cluster
from calib.stages.fingerprint import code_fingerprint, digest
from calib.stages.parallel import Request, run_parallel
from calib.stages.stage_file import Failure, unpack
from calib.study.conditions import ADVICE, CONDITIONS, MISTAKES

Record = dict[str, Any]


@dataclass(frozen=True)
class StudyTask:
    """One rig of one condition."""

    condition: str
    seed: int
    number: int
    key: str


def key_of(condition: str, seed: int) -> str:
    """Return the hash of all that a condition's results depend on, the rig's number left out."""
    fields = asdict(CONDITIONS[condition]) if condition in CONDITIONS else condition
    own = {ADVICE: "calib.study.advice", MISTAKES: "calib.study.faults"}
    module = own.get(condition, "calib.study.trial")
    return digest(fields, seed, code_fingerprint(module))[:16]


def perform(task: StudyTask) -> Record:
    """Return the record of one rig; the same on any machine with these versions."""
    if task.condition == ADVICE:
        from calib.study.advice import run_advice

        record: Record = run_advice(seed=task.seed, number=task.number)
    elif task.condition == MISTAKES:
        from calib.study.faults import run_faults

        record = run_faults(seed=task.seed, number=task.number)
    else:
        from calib.study.trial import run_trial

        record = run_trial(CONDITIONS[task.condition], seed=task.seed, number=task.number)
    record["key"] = task.key
    return record


def perform_all(
    tasks: Sequence[StudyTask], *, jobs: int, scheduler: str | None
) -> Iterator[Record]:
    """Yield records in the order in which they are finished.

    Parameters
    ----------
    jobs
        Processes on this machine; 1 works in this one.
    scheduler
        Address of a Dask scheduler to work on instead.

    Raises
    ------
    UsageError
        If the cluster cannot be reached.
    CalibError
        If a worker dies; on a cluster, if several die over one rig.
    """
    if scheduler is not None:
        return run_on_cluster(perform, tasks, scheduler)
    if jobs == 1:
        return map(perform, tasks)
    return _on_processes(tasks, jobs)


def perform_stage(*, task: Mapping[str, Any]) -> Record:
    """Return the record of a rig whose task comes as its fields."""
    return perform(StudyTask(**task))


def _on_processes(tasks: Sequence[StudyTask], jobs: int) -> Iterator[Record]:
    requests = [
        Request(
            f"{task.condition}, rig {task.number}",
            address(perform_stage),
            (),
            {"task": asdict(task)},
        )
        for task in tasks
    ]
    with closing(run_parallel(requests, workers=min(jobs, len(tasks)))) as outcomes:
        for name, content in outcomes:
            record = unpack(content, Record)
            if isinstance(record, Failure):
                raise EstimationError(f"{name}: {record.reason}")
            yield record
