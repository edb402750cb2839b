"""A signal is never lost in a finaliser. Evidence: property, and a negative control."""

from __future__ import annotations

import os
import signal
import time
import weakref
from collections.abc import Callable, Iterator

import pytest

from calib.stages.interruption import interrupt_on


class Finalised:
    """Runs something while it is finalised."""

    def __init__(self, run: Callable[[], None]) -> None:
        self.run = run

    def __del__(self) -> None:
        self.run()


class Thing:
    """May be referred to weakly."""


@pytest.fixture
def as_before() -> Iterator[None]:
    kept = {each: signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGALRM)}
    yield
    for each, handler in kept.items():
        signal.signal(each, handler)


def terminate() -> None:
    os.kill(os.getpid(), signal.SIGTERM)


def finalise() -> None:
    Finalised(terminate)


def finalise_weakly() -> None:
    thing = Thing()
    kept = weakref.finalize(thing, terminate)
    del thing
    assert not kept.alive


@pytest.mark.parametrize("act", [terminate, finalise, finalise_weakly])
@pytest.mark.usefixtures("as_before")
def test_signal_interrupts(act: Callable[[], None]) -> None:
    interrupt_on(signal.SIGTERM)
    done: list[bool] = []

    def wait() -> None:
        act()
        done.append(True)
        time.sleep(5)

    with pytest.raises(KeyboardInterrupt):
        wait()
    assert bool(done) == (act is not terminate), "a finaliser ends first"


# What Python does with an exception in a finaliser is what is shown here.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.usefixtures("as_before")
def test_without_it_python_loses_the_signal() -> None:
    def raising(*_: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, raising)
    finalise()
