"""What is certified of a check standard: lengths between its targets, depths, and their names."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict, Field


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class CertifiedLength(_Section):
    """A certified distance of two targets, and its standard uncertainty, mm."""

    between: tuple[str, str]
    length_mm: float = Field(gt=0)
    u_mm: float = Field(ge=0)

    @property
    def name(self) -> str:
        """As printed."""
        return f"length {self.between[0]} to {self.between[1]}"


class CertifiedDepth(_Section):
    """A known depth of a target in frame C1, and its standard uncertainty, mm."""

    target: str
    z_mm: float = Field(gt=0)
    u_mm: float = Field(ge=0)

    @property
    def name(self) -> str:
        """As printed."""
        return f"depth of {self.target}"


class Standard(_Section):
    """A check standard, as standard.toml describes it."""

    format: int = Field(ge=1, le=1)
    serial: str = Field(min_length=1)
    length: tuple[CertifiedLength, ...] = ()
    depth: tuple[CertifiedDepth, ...] = ()
    gazed: Mapping[str, str] = Field(default={}, alias="targets")

    def gazed_as(self, name: str) -> str:
        """Return what the rig looks for to gaze at a target: a target of `calib gaze`."""
        return self.gazed.get(name, name)

    @property
    def quantities(self) -> tuple[CertifiedLength | CertifiedDepth, ...]:
        """All that is certified."""
        return (*self.length, *self.depth)

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of all targets, each once."""
        ends = [end for one in self.length for end in one.between]
        return tuple(dict.fromkeys([*ends, *(one.target for one in self.depth)]))
