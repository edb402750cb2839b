"""What all pages show: written by the worker, read by whoever serves them."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final

from calib.rig.protocols import Interrupted

LINES: Final = 60
SHOWN: Final = 200
"""Measurements that a page gets; the CSV file has all."""


class Record:
    """The state of a session, with a number that grows as it changes. May be shared by threads."""

    def __init__(self) -> None:
        # Re-entrant: a signal's handler may come while its thread holds it.
        self._lock = threading.RLock()
        self._answered = threading.Condition(self._lock)
        self._fields: dict[str, Any] = {"job": None, "waiting": [], "question": None}
        self._lines: deque[dict[str, str]] = deque(maxlen=LINES)
        self._answer: str | None = None
        self._listeners: list[Callable[[], None]] = []
        self.version = 0

    def listen(self, listener: Callable[[], None]) -> None:
        """Call `listener` whenever something changes, from whatever thread changed it."""
        with self._lock:
            self._listeners.append(listener)

    def put(self, **fields: Any) -> None:
        """Set fields; each must be of JSON's kinds and is not changed afterwards."""
        with self._lock:
            if all(self._fields.get(name, self) == value for name, value in fields.items()):
                return
            self._fields.update(fields)
            self._changed()

    def get(self, name: str) -> Any:
        """Return a field; None if it was never set."""
        with self._lock:
            return self._fields.get(name)

    def add(self, name: str, entry: Mapping[str, Any]) -> None:
        """Add to a list of which only the newest entries are kept."""
        with self._lock:
            before = self._fields.get(name) or []
            self._fields[name] = [*before, dict(entry)][-SHOWN:]
            self._changed()

    def tell(self, text: str, *, bad: bool = False) -> None:
        """Add a line to the log."""
        with self._lock:
            at = time.strftime("%H:%M:%S")
            self._lines.append({"at": at, "text": text, "kind": "bad" if bad else "good"})
            self._changed()

    def snapshot(self) -> tuple[int, dict[str, Any]]:
        """Return the number of the state and the state."""
        with self._lock:
            return self.version, {**self._fields, "log": list(self._lines)}

    def ask(self, text: str, kind: str, *, refuse: Callable[[], None]) -> str:
        """Ask the owner and return the answer.

        Parameters
        ----------
        refuse
            Raises `Interrupted` if Stop was pressed before there was a question.

        Raises
        ------
        Interrupted
            If Stop is the answer.
        """
        with self._answered:
            refuse()
            self._answer = None
            self.put(question={"text": text, "kind": kind})
            self._answered.wait_for(lambda: self._fields["question"] is None)
            return self._answered_text()

    def _answered_text(self) -> str:
        if self._answer is None:
            raise Interrupted("stopped")
        return self._answer

    def answer(self, text: str | None) -> None:
        """Answer the question, if there is one; None withdraws it."""
        with self._answered:
            if self._fields["question"] is None:
                return
            self._answer = text
            self.put(question=None)
            self._answered.notify_all()

    def _changed(self) -> None:
        self.version += 1
        for listener in self._listeners:
            listener()
