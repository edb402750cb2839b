"""The hand that puts targets before a real rig: an operator's, who is asked on the page."""

from __future__ import annotations

import math
from collections.abc import Callable

from calib.live.record import Record


class PageHand:
    """An operator at the page.

    Parameters
    ----------
    record
        Where questions are shown and answered.
    refuse
        Raises `Interrupted` after a stop.
    """

    def __init__(self, record: Record, refuse: Callable[[], None]) -> None:
        self._record = record
        self._refuse = refuse

    def place(self, name: str) -> None:
        """Ask for the next target and wait until it is there."""
        self._asked(f"{name}: put the target up, at rest", "ready")

    def depth_mm(self, name: str) -> tuple[float, float | None] | None:
        """Ask for the depth."""
        while True:
            text = self._asked(f"{name}: its depth in mm", "number")
            try:
                depth = float(text)
            except ValueError:
                depth = math.nan
            if 0 < depth < math.inf:
                return depth, None
            self._record.tell(f"{text!r} is no depth: a number of millimetres, above 0", bad=True)

    def place_again(self, name: str, *, of: str) -> None:
        """Ask for a target that stood there before and wait until it is there."""
        self._asked(f"{name}: put the target of {of} back where it stood then, at rest", "ready")

    def _asked(self, text: str, kind: str) -> str:
        return self._record.ask(text, kind, refuse=self._refuse)
