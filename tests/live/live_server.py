"""The page's server in this process, on a port of its own, with its session at hand."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from calib.live.access import Access
from calib.live.bench import Places
from calib.live.serve import Server, address, listen, make_server
from calib.live.session import THIS_PROGRAM, Given, Session
from calib.rig.settings import RigSettings, embedded


@dataclass(frozen=True)
class Live:
    """A server that runs."""

    session: Session
    access: Access
    port: int
    url: str
    server: Server

    @property
    def app(self):
        return self.server.config.app

    @property
    def record(self):
        return self.session.record

    def until(self, wanted, *, seconds=60.0):
        """Wait until the published state is as wanted; return it."""
        end = time.monotonic() + seconds
        while True:
            state = self.record.snapshot()[1]
            if wanted(state):
                return state
            assert time.monotonic() < end, state
            time.sleep(0.005)

    def idle(self, *, seconds=60.0):
        return self.until(lambda s: s["job"] is None and not s["waiting"], seconds=seconds)

    def turning(self):
        return self.until(lambda s: s.get("turning"))

    def true_yaw(self):
        """Return where C2 truly stands, rad."""
        world = self.session._bench.rig.world
        return world.yaw(world.clock.now_ns())


def settings(**virtual: object) -> RigSettings:
    given = embedded().model_dump(exclude_none=True)
    given["virtual"] |= virtual
    return RigSettings.model_validate(given)


@contextmanager
def live(
    folder: Path, *, host="127.0.0.1", rig=None, calibration=None, calib=THIS_PROGRAM, rig_file=None
) -> Iterator[Live]:
    given = Given(
        settings=rig or embedded(),
        places=Places(rig_file, folder / "datasets" / "live", folder / "reports" / "live"),
        calibration=calibration,
        calib=calib,
    )
    access = Access(host)
    with listen(host, 0) as listening, Session(given) as session:
        server = make_server(session, access)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            port = listening.getsockname()[1]
            yield Live(session, access, port, address(listening, access), server)
        finally:
            server.should_exit = True
            thread.join(30)
            assert not thread.is_alive()
