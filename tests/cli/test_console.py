"""What a terminal, and what a file, is shown while stages run. Evidence: property."""

from __future__ import annotations

import io
import os
import pty
import sys
import termios
from contextlib import suppress

import pytest

from calib.cli.console import Console


def talk(console: Console) -> None:
    """Two stages at work at the same time, then a third."""
    console.announce("one")
    console.announce("two")
    for done in (1, 2):
        console.progress("one", done, 4)
        console.progress("two", 10 * done, 20)
    console.announce("three")
    console.progress("one", 5, 4)
    console.close()


def test_terminal_shows_a_bar_for_each_stage_at_work(monkeypatch: pytest.MonkeyPatch) -> None:
    keyboard, screen = pty.openpty()
    termios.tcsetwinsize(screen, (24, 80))
    with os.fdopen(screen, "w") as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        talk(Console())
    pieces = []
    with suppress(OSError):  # the terminal's other end is closed: all has been read
        while piece := os.read(keyboard, 65536):
            pieces.append(piece)
    os.close(keyboard)
    shown = b"".join(pieces).decode()
    first, second = shown.split("  three")
    for text in ("  one: ", "  two: ", "1/4", "2/4", "10/20", "20/20"):
        assert text in first, text
    assert "  one: 100%" in second, "of a stage still at work the bar comes back; 5 of 4 is all"
    assert "5/5" in second
    assert "  two: " not in second


def test_file_gets_names_only(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    talk(Console())
    assert stream.getvalue() == "  one\n  two\n  three\n"
