"""Words of messages."""

from __future__ import annotations


def counted(number: int, noun: str) -> str:
    """Return how many there are: 1 rig, 2 rigs, no rigs."""
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"
