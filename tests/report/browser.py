"""Headless Chromium, driven over its debugging pipe: pages, scripts, and all that it reports."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-pipe",
)


class Browser:
    """A running browser with one open page.

    It listens to nothing on the network: commands go in by file descriptor 3, answers and events
    come out by 4, each JSON ended by a zero byte.
    """

    def __init__(self, to_browser: int, from_browser: int) -> None:
        self._to, self._from = to_browser, from_browser
        self._rest, self._last, self._session = b"", 0, ""
        self.events: list[dict[str, Any]] = []

    def open(self) -> None:
        """Open an empty page and listen to what it does."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and return its result; events meanwhile are kept."""
        self._last += 1
        message: dict[str, Any] = {"id": self._last, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._last:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                result: dict[str, Any] = answer["result"]
                return result
            self.events.append(answer)

    def go(self, address: str) -> None:
        """Load a page, and wait until all of it is there."""
        self.call("Page.navigate", url=address)
        while not any(e.get("method") == "Page.loadEventFired" for e in self.events):
            self.events.append(self._read())

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression on the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(str(answer["exceptionDetails"]))
        return answer["result"].get("value")

    def of(self, *methods: str) -> list[dict[str, Any]]:
        """Return the parameters of all events of these kinds."""
        return [e["params"] for e in self.events if e.get("method") in methods]

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            some = os.read(self._from, 1 << 16)
            if not some:
                raise RuntimeError("the browser has gone")
            self._rest += some
        message, _, self._rest = self._rest.partition(b"\0")
        decoded: dict[str, Any] = json.loads(message)
        return decoded


@contextmanager
def chromium(*flags: str) -> Iterator[Browser]:
    """Give a browser with a profile of its own; both are gone afterwards."""
    binary = shutil.which("chromium") or shutil.which("chromium-browser")
    assert binary is not None, "chromium is missing; `make test` installs it"
    into_read, into_write = os.pipe()
    out_read, out_write = os.pipe()
    profile = tempfile.mkdtemp(prefix="calib-browser-")
    # The browser wants its pipe at descriptors 3 and 4.
    script = f'exec 3<&{into_read} 4>&{out_write}; exec "$0" "$@"'
    process = subprocess.Popen(
        ["bash", "-c", script, binary, *FLAGS, f"--user-data-dir={profile}", *flags],
        pass_fds=(into_read, out_write),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(into_read)
    os.close(out_write)
    browser = Browser(into_write, out_read)
    try:
        browser.open()
        yield browser
    finally:
        process.kill()
        process.wait()
        os.close(into_write)
        os.close(out_read)
        shutil.rmtree(profile, ignore_errors=True)
