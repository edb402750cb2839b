"""The server's process: where it listens, what it prints, and how it ends."""

from __future__ import annotations

import signal
import socket
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import Final

import uvicorn

from calib.core.errors import CalibError, UsageError
from calib.live.access import Access
from calib.live.app import make_app
from calib.live.session import Given, Session

PING_S: Final = 5.0
"""A page whose machine or network is gone is found so much later, twice at most."""

MESSAGE_BYTES: Final = 16_384
GRACE_S: Final = 2


class Server(uvicorn.Server):
    """A server whose signals stop the motor before anything else.

    Parameters
    ----------
    config
        Of uvicorn.
    stop
        Stops the motor.
    """

    def __init__(self, config: uvicorn.Config, stop: Callable[[], None]) -> None:
        super().__init__(config)
        self._stop = stop

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:  # noqa: ARG002 - as uvicorn calls it
        """End the server; the second time at once."""
        with suppress(CalibError, OSError):  # an axis that does not answer keeps nobody here
            self._stop()
        self.force_exit = self.should_exit
        self.should_exit = True


def listen(host: str, port: int) -> socket.socket:
    """Return a listening socket.

    Raises
    ------
    UsageError
        If the address is not this machine's or the port is taken.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise UsageError(
            f"cannot listen at {host}, port {port} ({error.strerror or error}); give another "
            "--port, 0 for any that is free, or --host"
        ) from None


def address(listening: socket.socket, access: Access) -> str:
    """Return the address to open, with the token."""
    host = access.host
    if host in ("0.0.0.0", "::"):  # noqa: S104 - compared, not listened at
        host = socket.gethostname()
    elif ":" in host:
        host = f"[{host}]"
    return f"http://{host}:{listening.getsockname()[1]}/?token={access.token}"


def make_server(session: Session, access: Access) -> Server:
    """Return the server of a session."""
    config = uvicorn.Config(
        make_app(session, access),
        ws="websockets-sansio",
        ws_ping_interval=PING_S,
        ws_ping_timeout=PING_S,
        ws_max_size=MESSAGE_BYTES,
        lifespan="off",
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=GRACE_S,
    )
    return Server(config, session.stop)


def serve(given: Given, *, host: str, port: int, announce: Callable[[str], None]) -> None:
    """Open the rig and serve its page until Ctrl-C.

    Parameters
    ----------
    announce
        Told the address, once the page can be opened.

    Raises
    ------
    CalibError
        If the rig cannot be opened, or the port is taken.
    """
    access = Access(host)
    with listen(host, port) as listening, Session(given) as session:
        server = make_server(session, access)
        former = signal.signal(signal.SIGHUP, server.handle_exit)
        announce(address(listening, access))
        try:
            server.run(sockets=[listening])
        finally:
            signal.signal(signal.SIGHUP, former)
