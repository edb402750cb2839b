"""Gates: what must hold before a result may be used."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Gate:
    """The outcome of one check on a result.

    Parameters
    ----------
    name
        Short and stable: scripts look for it.
    passed
        Whether the result may be used as far as this check goes.
    detail
        The figures that decided it and, where it failed, the next step.
    """

    name: str
    passed: bool
    detail: str


def failed(gates: Iterable[Gate]) -> tuple[Gate, ...]:
    """Return those that did not pass."""
    return tuple(gate for gate in gates if not gate.passed)
