"""From where reference depths count, as a manifest says it: `z_from` of [gaze] and [validation].

Depth counts from C1's optical centre, which no ruler reaches. Labs measure from the lens's front,
its flange or the housing, some centimetres in front of it.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict

from calib.dataset.fields import NotNegative, Number, refuse
from calib.dataset.messages import shown

OPTICAL_CENTRE = "c1"

_EXAMPLE = 'z_from = "c1", or z_from = { ahead_of_c1_mm = 35.0, u_mm = 2.0 }'


class Ahead(BaseModel):
    """z_mm counts from a place so far in front of C1's optical centre, with what is uncertain."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    ahead_of_c1_mm: Number
    u_mm: NotNegative


def _known_form(value: object) -> object:
    if value != OPTICAL_CENTRE and not isinstance(value, dict | Ahead):
        refuse(f"{shown(value)} is no place that z_mm can count from", f"write {_EXAMPLE}")
    if isinstance(value, dict) and set(value) != {"ahead_of_c1_mm", "u_mm"}:
        refuse("it needs ahead_of_c1_mm and u_mm, and nothing else", f"write {_EXAMPLE}")
    return value


DepthOrigin = Annotated[Literal["c1"] | Ahead, BeforeValidator(_known_form)]


_CALIBRATED = ("stereo", "image pair")
"""Words of a reference whose depths come from a calibrated C1, and so count from its centre."""


def origin_of(stated: Literal["c1"] | Ahead | None, reference: str) -> Literal["c1"] | Ahead | None:
    """Return from where depths count: as stated, or as the name of the reference implies.

    None where neither says it.
    """
    if stated is None and any(word in reference.lower() for word in _CALIBRATED):
        return "c1"
    return stated


def ahead_of_c1(origin: Literal["c1"] | Ahead | None) -> tuple[float, float]:
    """Return how far in front of C1's optical centre depths count from, and its uncertainty, mm."""
    return (origin.ahead_of_c1_mm, origin.u_mm) if isinstance(origin, Ahead) else (0.0, 0.0)
