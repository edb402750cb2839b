"""What all parts of calibration.json have in common."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

Vector = list[float]
Matrix = list[list[float]]


class Part(BaseModel):
    """A section; it holds the keys below and no others."""

    model_config = ConfigDict(extra="forbid")
