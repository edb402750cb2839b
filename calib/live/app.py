"""The server's answers: the page and its files, and one WebSocket for each open page.

A page asks for each picture, and gets the newest; it gets the state when that has changed since the
last time. So nothing waits for a slow page but the page itself, and no queue grows.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from importlib.resources import files
from typing import Final

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from calib.core.errors import CalibError, UsageError
from calib.live.access import Access, Guarded, token_of
from calib.live.commands import Answer, Command, Job, Mark, Pick, Picture, Stop, Take, parse
from calib.live.jobs import RUN_FILES
from calib.live.session import Session
from calib.live.streams import ShownPicture

STATIC: Final = {
    "live.css": "text/css",
    "live.js": "text/javascript",
    "pictures.js": "text/javascript",
    "scene.js": "text/javascript",
    "tables.js": "text/javascript",
}

SAID: Final = 8
"""Notices and answers that a slow page may be behind with."""

COMMON_HEADERS: Final = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
PAGE_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
RUN_POLICY: Final = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data:; font-src data:; frame-ancestors 'self'"
)
"""A report brings its script along; sandboxed, it is of no origin and cannot ask for anything."""


class Page:
    """One open page.

    Parameters
    ----------
    socket
        Its connection.
    may_command
        Whether it brought the token.
    """

    def __init__(self, socket: WebSocket, *, may_command: bool) -> None:
        self.socket = socket
        self.may_command = may_command
        self.wake = asyncio.Event()
        self.wanted: set[str] = set()
        self.sent: dict[str, int] = {}
        self.state_sent: tuple[int, ...] = ()
        self.said: deque[dict[str, str]] = deque(maxlen=SAID)
        self.picking: asyncio.Task[None] | None = None


class Pages:
    """All open pages, and which of them has the motor.

    Parameters
    ----------
    session
        The rig.
    access
        Who may ask what.
    """

    def __init__(self, session: Session, access: Access) -> None:
        self._session = session
        self._access = access
        self._pages: set[Page] = set()
        self._owner: Page | None = None
        self._changes = 0

    def listen(self) -> None:
        """Hear of changes from now on, in the loop that runs now."""
        loop = asyncio.get_running_loop()

        def changed() -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(self._wake)

        self._session.record.listen(changed)
        for stream in self._session.streams.values():
            stream.listen(changed)

    async def serve(self, page: Page) -> None:
        """Serve a page until it is closed."""
        self._pages.add(page)
        if page.may_command and self._owner is None:
            self._owner = page
        self._change()
        sending = asyncio.create_task(self._send(page))
        try:
            while True:
                await self._receive(page, await page.socket.receive_text())
        except (WebSocketDisconnect, KeyError):  # KeyError: a message that is no text
            pass
        finally:
            sending.cancel()
            self._pages.discard(page)
            if self._owner is page:
                self._owner = None
                await asyncio.shield(asyncio.to_thread(self._session.owner_left))
            self._change()

    async def _receive(self, page: Page, text: str) -> None:
        try:
            await self._obey(page, parse(text))
        except CalibError as error:
            page.said.append({"notice": str(error)})
        page.wake.set()

    async def _obey(self, page: Page, command: Command) -> None:
        if isinstance(command, Picture):
            page.wanted.add(command.camera)
            self._session.streams[command.camera].ask()
            return
        if not page.may_command:
            raise UsageError("this page only watches: open the address that holds the token")
        if isinstance(command, Stop):
            # Whoever may command may stop, whoever has the motor.
            await asyncio.to_thread(self._session.stop)
            return
        if isinstance(command, Take):
            if self._owner is None:
                self._owner = page
                self._change()
            return
        if page is not self._owner:
            raise UsageError("another page has the motor")
        self._let(page, command)

    def _let(self, page: Page, command: Job | Answer | Mark | Pick) -> None:
        """Do what the page that has the motor asks for."""
        if isinstance(command, Answer):
            self._session.answer(command)
        elif isinstance(command, Mark):
            self._session.mark(command)
        elif isinstance(command, Pick):
            if page.picking is None or page.picking.done():
                page.picking = asyncio.create_task(self._pick(page, command))
        else:
            self._session.submit(command)

    async def _pick(self, page: Page, pick: Pick) -> None:
        """Look for what is pointed at; a Stop that comes meanwhile does not wait for it."""
        try:
            page.said.append({"picked": await asyncio.to_thread(self._session.pick, pick)})
        except CalibError as error:
            page.said.append({"notice": str(error)})
        page.wake.set()

    def _change(self) -> None:
        self._changes += 1
        self._wake()

    def _wake(self) -> None:
        for page in self._pages:
            page.wake.set()

    async def _send(self, page: Page) -> None:
        """Send what a page has asked for and does not have yet, whenever there is something."""
        try:
            while True:
                page.wake.clear()
                await self._send_state(page)
                for camera in tuple(page.wanted):
                    await self._send_picture(page, camera)
                await page.wake.wait()
        except (WebSocketDisconnect, RuntimeError):
            return  # the page was closed meanwhile

    async def _send_state(self, page: Page) -> None:
        while page.said:
            await page.socket.send_text(json.dumps(page.said.popleft()))
        version, state = self._session.record.snapshot()
        now = (version, self._changes)
        if page.state_sent == now:
            return
        page.state_sent = now
        role = "owner" if page is self._owner else "watcher"
        mine = {
            "role": role,
            "may_command": page.may_command,
            "owned": self._owner is not None,
            "pages": len(self._pages),
            "local": self._access.is_local,
        }
        await page.socket.send_text(json.dumps({"state": state, "page": mine}, allow_nan=False))

    async def _send_picture(self, page: Page, camera: str) -> None:
        stream = self._session.streams[camera]
        shown = stream.shown
        if shown is None or page.sent.get(camera) == shown.number:
            stream.ask()
            return
        page.wanted.discard(camera)
        page.sent[camera] = shown.number
        await page.socket.send_bytes(picture_message(camera, shown, stream.age_ms(shown)))


def picture_message(camera: str, shown: ShownPicture, age_ms: float) -> bytes:
    """Return a picture as it is sent: length of the head, 4 bytes, the head, JSON, the JPEG."""
    head = json.dumps(
        {
            "camera": camera,
            "serial": shown.serial,
            "size": shown.size,
            "age_ms": round(age_ms, 1),
            "target": shown.target,
            "marks": shown.marks,
            "centre": shown.centre_px,
        }
    ).encode()
    return len(head).to_bytes(4, "big") + head + shown.jpeg


def make_app(session: Session, access: Access) -> ASGIApp:
    """Return the application that serves a session."""
    pages = Pages(session, access)
    listening: list[bool] = []

    async def index(_: Request) -> Response:
        return HTMLResponse(_static("index.html"), headers=_headers(PAGE_POLICY))

    async def static(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in STATIC:
            raise HTTPException(404)
        return Response(_static(name), media_type=STATIC[name], headers=_headers(PAGE_POLICY))

    async def run_file(request: Request) -> Response:
        name = request.path_params["name"]
        path = session.places.run / name
        if name not in RUN_FILES or not path.is_file():
            raise HTTPException(404)
        kind = "inline" if name.endswith(".html") else "attachment"
        return FileResponse(
            path, headers=_headers(RUN_POLICY), filename=name, content_disposition_type=kind
        )

    async def positions(_: Request) -> Response:
        return _csv(session.measurements_csv(), "positions.csv")

    async def lengths(_: Request) -> Response:
        return _csv(session.lengths_csv(), "lengths.csv")

    async def connect(socket: WebSocket) -> None:
        if not listening:
            listening.append(True)
            pages.listen()
        await socket.accept()
        page = Page(socket, may_command=access.knows_token(token_of(socket.scope)))
        await pages.serve(page)

    routes = [
        Route("/", index),
        Route("/static/{name}", static),
        Route("/run/{name}", run_file),
        Route("/positions.csv", positions),
        Route("/lengths.csv", lengths),
        WebSocketRoute("/ws", connect),
    ]
    return Guarded(Starlette(routes=routes), access)


def _headers(policy: str) -> dict[str, str]:
    return COMMON_HEADERS | {"Content-Security-Policy": policy}


def _static(name: str) -> bytes:
    return (files("calib.live") / "static" / name).read_bytes()


def _csv(text: str, name: str) -> Response:
    headers = COMMON_HEADERS | {"Content-Disposition": f'attachment; filename="{name}"'}
    return PlainTextResponse(text, media_type="text/csv", headers=headers)
