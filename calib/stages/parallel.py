"""Computes stages that do not need each other at the same time, in processes of their own.

Threads would wait for each other: these stages spend their time in Python. The processes are
started afresh and not forked, for a fork of a process with threads or native libraries in use may
hang; and not by `multiprocessing`, which would run the caller's main module again in each of them.
Inputs and outcomes cross as the bytes of stage files, so that a stage cannot tell where it runs.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import IO, Any, NoReturn, TypeAlias

from calib.core.errors import CalibError
from calib.core.parent import ending_with_this
from calib.stages.call import Progress
from calib.stages.message import receive, send
from calib.stages.worker import ASKED_TO_END

GRACE_S = 3.0
"""Time to end after being asked to; a long call of a library may take more."""

_WORKER = "calib.stages.worker"

_ENVIRONMENT = {
    # One thread: the sums, and so the last digits, are then the same on every machine.
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}


@dataclass(frozen=True)
class Request:
    """A stage to compute, by its address (see `calib.stages.call`); the inputs are packed."""

    name: str
    target: str
    inputs: tuple[bytes, ...]
    settings: Mapping[str, Any]


_Order: TypeAlias = Callable[[], tuple[str, bytes] | None]
"""What a worker's thread wants done: tell the caller something, or give it an outcome."""


PROCESSORS = "CALIB_PROCESSORS"
"""Environment variable: how many processors a run uses at most."""


def processors() -> int:
    """Return how many processors this process may use."""
    wanted = os.environ.get(PROCESSORS, "")
    allowed = len(os.sched_getaffinity(0))
    return min(allowed, max(int(wanted), 1)) if wanted.isdecimal() else allowed


def run_parallel(
    requests: Sequence[Request],
    *,
    workers: int,
    started: Callable[[str], None] = lambda _: None,
    progress: Progress = lambda *_: None,
) -> Generator[tuple[str, bytes]]:
    """Yield name and packed outcome of each stage as it is finished.

    As many are computed at a time as there are workers, begun in the order given. When the caller
    closes the generator, or Ctrl-C interrupts it, the workers are ended; where this process dies,
    they die with it.

    Parameters
    ----------
    started, progress
        Told of each stage, in the caller's thread, that it starts and how far it is.

    Raises
    ------
    CalibError
        If a stage raises one, or a worker was killed, as by a system short of memory.
    RuntimeError
        If a stage failed by a defect; the message has its traceback.
    """
    waiting: SimpleQueue[Request] = SimpleQueue()
    for request in requests:
        waiting.put(request)
    orders: SimpleQueue[_Order] = SimpleQueue()
    left = len(requests)
    with ExitStack() as stack:
        for _ in range(workers):
            stack.enter_context(_worker(waiting, orders, started, progress))
        while left:
            finished = orders.get()()
            if finished is not None:
                left -= 1
                yield finished


@contextmanager
def _worker(
    waiting: SimpleQueue[Request],
    orders: SimpleQueue[_Order],
    started: Callable[[str], None],
    progress: Progress,
) -> Iterator[None]:
    """Keep a process at work, fed by a thread; it finds this very package and no other."""
    here = str(Path(__file__).parents[2])
    search = os.pathsep.join(filter(None, (here, os.environ.get("PYTHONPATH"))))
    process = subprocess.Popen(  # noqa: S603 - no shell; this very interpreter
        # -P: not the working directory, where anything may lie.
        [sys.executable, "-P", "-m", _WORKER],
        env={**os.environ, **_ENVIRONMENT, **ending_with_this(), "PYTHONPATH": search},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    thread = Thread(target=_feed, args=(process, waiting, orders, started, progress))
    try:
        thread.start()
        yield
    finally:
        _end(process)
        thread.join()
        # A request that a dead worker has not read would be sent once more.
        with suppress(BrokenPipeError), process:
            pass


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a worker: with the processes that it may have started itself, if it has time for it."""
    process.terminate()
    try:
        process.wait(GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()


def _feed(
    process: subprocess.Popen[bytes],
    waiting: SimpleQueue[Request],
    orders: SimpleQueue[_Order],
    started: Callable[[str], None],
    progress: Progress,
) -> None:
    """Give a worker one request after another; runs in a thread of its own."""
    requests: IO[bytes] = process.stdin  # type: ignore[assignment] # it is a pipe
    replies: IO[bytes] = process.stdout  # type: ignore[assignment] # it is a pipe
    while True:
        try:
            request = waiting.get_nowait()
        except Empty:
            return
        orders.put(partial(started, request.name))
        with suppress(BrokenPipeError):
            _ask(requests, request)
        while (reply := receive(replies)) is not None and reply[0]["is"] == "progress":
            orders.put(partial(progress, request.name, *reply[0]["steps"]))
        if reply is None:
            orders.put(partial(_lost, request.name, process.wait()))
            return
        orders.put(partial(_ended, request.name, reply[0]["is"], reply[1]))


def _ask(stream: IO[bytes], request: Request) -> None:
    header = {
        "name": request.name,
        "target": request.target,
        "settings": request.settings,
        "sizes": [len(content) for content in request.inputs],
    }
    send(stream, header, b"".join(request.inputs))


def _ended(name: str, how: str, content: bytes) -> tuple[str, bytes]:
    """Return the outcome of a stage, or raise what it has raised."""
    if how == "refusal":
        raise CalibError(content.decode())
    if how == "defect":
        raise RuntimeError(f"{name} failed in its process:\n{content.decode()}")
    return name, content


def _lost(name: str, status: int) -> NoReturn:
    """Say how a worker ended that should not have."""
    if status == ASKED_TO_END:
        raise CalibError(
            f"{name}: its process was ended from outside (SIGTERM); run again: what was finished "
            "is kept"
        )
    if status >= 0:
        raise RuntimeError(f"{name}: its process ended with status {status}")
    reason = ", as systems do that run out of memory" if -status == signal.SIGKILL else ""
    raise CalibError(
        f"{name}: its process was killed ({signal.Signals(-status).name}){reason}; "
        "run again: what was finished is kept"
    )
