"""The chain with few draws: every stage, file and message of a run in a fraction of its time.

`shorten` does it in this process. As a script this file starts runs on request, each in a fork of
its own that a test can kill: one JSON list of arguments a line in, process id and status out.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import calib.chain.outputs
import calib.fit.chains
import calib.stages.store

MANIFEST = """\
format = 1
name = "rig"
[encoder]
resolution_deg = 0.05625
[gaze]
table = "gaze.csv"
z_from = "c1"
u_x1c = 0.0002
u_z_rel = 0.002
[validation]
table = "validation.csv"
"""

GAZE = """\
id,x1c,alpha2_deg,z_mm
1,0.1018,86.150,485.9
2,0.2635,95.006,486.5
3,0.2353,96.950,796.4
4,0.0229,85.210,805.9
5,0.0162,85.859,1008.5
6,0.1624,94.033,998.5
"""

VALIDATION = """\
id,x1c,alpha2_deg,z_mm
a,0.0500,86.200,700
b,0.1500,92.500,900
"""

SHORT = {"TAU_MULTIPLE": 3.0, "ESS_GOAL": 50.0, "R_HAT_LIMIT": 2.0, "WALKER_R_HAT_LIMIT": 9.0}
"""Of `calib.fit.chains`; no source is changed, so fingerprints are those of full runs."""


def shorten(assign: Callable[[object, str, object], object]) -> None:
    """Cut the chains short, in this process; `assign` is setattr or monkeypatch.setattr."""
    for name, value in SHORT.items():
        assign(calib.fit.chains, name, value)
    assign(calib.stages.store, "processors", lambda: 1)


def leave_out_pages(assign: Callable[[object, str, object], object]) -> None:
    """Have runs in this process write no report and no certificate: half of a short run's time."""
    assign(calib.chain.outputs, "render_report", lambda *_: "")
    assign(calib.chain.outputs, "_certificate", lambda *_, **__: ({}, None))


def dataset(folder: Path) -> Path:
    """Write a small dataset."""
    folder.mkdir(parents=True)
    (folder / "dataset.toml").write_text(MANIFEST)
    (folder / "gaze.csv").write_text(GAZE)
    (folder / "validation.csv").write_text(VALIDATION)
    return folder


@dataclass(frozen=True)
class Started:
    """A run under way, in a process that can be killed."""

    pid: int
    _server: subprocess.Popen[str]

    def announcements(self) -> Iterator[str]:
        """Yield the stages as they start, until the run ends."""
        err: IO[str] = self._server.stderr  # type: ignore[assignment] # it is a pipe
        while (line := err.readline()) and line != "ENDED\n":
            yield line.strip()

    def status(self) -> int:
        """Return the exit status, negative for a signal, once the run has ended."""
        return int(_answer(self._server))


def _answer(server: subprocess.Popen[str]) -> str:
    out: IO[str] = server.stdout  # type: ignore[assignment] # it is a pipe
    return out.readline()


@contextmanager
def starter() -> Iterator[Callable[..., Started]]:
    """Give a function that starts ``calib ARGUMENTS`` with short chains."""
    pipe = subprocess.PIPE
    command = [sys.executable, __file__]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as server:
        orders: IO[str] = server.stdin  # type: ignore[assignment] # it is a pipe

        def start(*arguments: object) -> Started:
            orders.write(json.dumps([str(a) for a in arguments]) + "\n")
            orders.flush()
            return Started(int(_answer(server)), server)

        yield start
        orders.close()


def _say(stream: IO[str], what: object) -> None:
    stream.write(f"{what}\n")
    stream.flush()


def _serve() -> None:
    import calib.chain.calibrate  # noqa: F401 - loaded once, for all forks
    from calib.cli.main import main

    shorten(setattr)
    for order in sys.stdin:
        pid = os.fork()
        if pid == 0:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            status = 1
            try:
                status = main(json.loads(order))
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(status)
        _say(sys.stdout, pid)
        _, ended = os.waitpid(pid, 0)
        _say(sys.stderr, "ENDED")
        _say(sys.stdout, os.waitstatus_to_exitcode(ended))


if __name__ == "__main__":
    _serve()
