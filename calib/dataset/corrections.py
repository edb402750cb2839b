"""Diagnosed causes that a manifest may accept."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import AfterValidator

from calib.dataset.fields import Line, refuse
from calib.dataset.messages import shown, suggestion

ACCEPTABLE: Final = (
    "range-not-depth",
    "reference-bias-near",
    "reference-bias-far",
    "reading-step",
    "reading-drift",
    "backlash",
    "rows-exchanged",
    "group-reference",
    "unit",
    "rehomed",
)
"""Causes that were of the calibration rows alone, so that correcting these mends all."""


def _acceptable(name: str) -> str:
    if name == "reference-offset":
        refuse("reference-offset needs no correction", "state z_from in [gaze]")
    if name.startswith(("c1-", "microstep", "encoder-", "x-", "y-")):
        refuse(
            f"{name} is of the rig and of each later reading, not of the rows alone",
            "mend it: the lens in [cameras.c1], the encoder by a yaw sweep",
        )
    if name not in ACCEPTABLE:
        refuse(f"unknown cause {shown(name)}", suggestion(name, ACCEPTABLE))
    return name


AcceptedCause = Annotated[Line, AfterValidator(_acceptable)]
"""Name of a diagnosed cause."""
