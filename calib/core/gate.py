"""Gates: what must hold before a result may be used."""

from __future__ import annotations

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
