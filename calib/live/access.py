"""Who may ask what: the names a request may come by, and the token of a run.

A page from elsewhere, open in the same browser, can send requests here. It cannot forge the headers
Host and Origin, and it cannot read the token, which stands in the address that is printed.
"""

from __future__ import annotations

import hmac
import secrets
import socket
from collections.abc import Iterable
from dataclasses import dataclass, field
from http import HTTPStatus
from ipaddress import ip_address
from urllib.parse import parse_qs, urlsplit

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")

OPEN = ("/static/",)
"""What may be had without a token, wherever the server listens: the program's own text."""


@dataclass(frozen=True)
class Access:
    """What requests have to show.

    Parameters
    ----------
    host
        Address that the server listens at.
    token
        Of this run.
    """

    host: str
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach the server."""
        return _is_loopback(self.host)

    def knows_host(self, header: str) -> bool:
        """Return whether a request's Host names this server.

        Another site's name that was made to point here (DNS rebinding) does not; an address that
        is written as a number is no name, and cannot be made to.
        """
        try:
            name = (urlsplit(f"//{header}").hostname or "").lower()
        except ValueError:  # no address at all, such as "["
            return False
        if self.is_local:
            return name in (*LOOPBACK_NAMES, self.host.lower())
        return _is_number(name) or name in _own_names(self.host)

    def knows_token(self, given: str) -> bool:
        """Return whether a request brings the token of this run."""
        return hmac.compare_digest(given.encode(), self.token.encode())

    def may_read(self, path: str, given: str) -> bool:
        """Return whether a page or file may be had."""
        return self.is_local or path.startswith(OPEN) or self.knows_token(given)


class Guarded:
    """Turns requests away: by a foreign name, from a foreign page, without the token they need."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer it with 403."""
        if scope["type"] in ("http", "websocket") and (why := self._refusal(scope)):
            if scope["type"] == "websocket":
                await receive()
                await send({"type": "websocket.close", "code": 1008, "reason": why})
            else:
                answer = PlainTextResponse(why + "\n", HTTPStatus.FORBIDDEN)
                await answer(scope, receive, send)
            return
        await self._app(scope, receive, send)

    def _refusal(self, scope: Scope) -> str:
        """Return why a request is refused; an empty text if it is not."""
        hosts, origins = _headers(scope, b"host"), _headers(scope, b"origin")
        if len(hosts) != 1 or not self._access.knows_host(hosts[0]):
            return "this server is not known by that name"
        if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
            return "another page's requests are not answered"
        if not self._access.may_read(scope["path"], token_of(scope)):
            return "the address needs the token that was printed when the server began"
        return ""


def token_of(scope: Scope) -> str:
    """Return the token in the query of a request; empty without one."""
    query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
    given: str = (query.get("token") or [""])[0]
    return given


def _headers(scope: Scope, name: bytes) -> list[str]:
    pairs: Iterable[tuple[bytes, bytes]] = scope["headers"]
    return [value.decode("latin-1") for key, value in pairs if key.lower() == name]


def _is_loopback(host: str) -> bool:
    return host.lower() == "localhost" or (_is_number(host) and ip_address(host).is_loopback)


def _is_number(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def _own_names(host: str) -> set[str]:
    names = {host, "localhost", socket.gethostname(), socket.getfqdn()}
    names |= {f"{name}.local" for name in names}
    return {name.lower() for name in names}
