"""What all sections of a manifest have in common."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A table of the manifest: frozen, and without room for unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)
