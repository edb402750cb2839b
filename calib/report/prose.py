"""Texts of checks and warnings, which terminal and files have in ASCII, as a page prints them."""

from __future__ import annotations

from calib.geometry.parameters import MODELS


def typeset(text: str) -> str:
    """Return a text with the signs that a terminal may lack."""
    return text.replace("+-", "±")


def capital(text: str) -> str:
    """Return a text that begins with a capital; names of models and columns stay as they are."""
    first = text.partition(" ")[0].rstrip(":,")
    is_name = first in MODELS or "_" in first or "-" in first or "/" in first or "." in first
    return text if is_name else text[:1].upper() + text[1:]


def sentence(text: str) -> str:
    """Return the detail of a check, or a warning, as a sentence."""
    told = capital(typeset(text))
    return told if told.endswith((".", "!", "?")) else f"{told}."
