"""What a driver's section in rig.toml may say: its own keys, checked by the driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from calib.core.errors import InputError, Problem
from calib.dataset.faults import words
from calib.dataset.messages import suggestion
from calib.rig.settings import AxisSection, CameraSection

HANDED: Final = ("role", "serial", "clock", "world")
"""What `calib.rig.devices.open_rig` adds to a section for the driver."""


class Options(BaseModel):
    """Keys of a driver's own: frozen, and without room for unknown ones."""

    model_config = ConfigDict(frozen=True, extra="forbid")


O = TypeVar("O", bound=Options)  # noqa: E741 - the type of options


def options(model: type[O], settings: Mapping[str, Any]) -> O:
    """Return a driver's own keys out of the section that it was handed.

    Raises
    ------
    InputError
        Naming each key that is missing, unknown or wrong.
    """
    role = str(settings.get("role", "device"))
    section = AxisSection if role == "axis" else CameraSection
    common = {*section.model_fields, *HANDED}
    own = {key: value for key, value in settings.items() if key not in common}
    place = "[axis]" if role == "axis" else f"[cameras.{role}]"
    try:
        return model.model_validate(own)
    except ValidationError as error:
        known = [*model.model_fields, *section.model_fields]
        raise InputError(
            [
                _problem(detail, place, str(settings.get("driver", "")), known)
                for detail in error.errors(include_url=False)
            ]
        ) from None


def _problem(detail: Any, place: str, driver: str, known: list[str]) -> Problem:
    name = str(detail["loc"][0])
    where = f"rig.toml, {place} {name}"
    if detail["type"] == "extra_forbidden":
        return Problem(
            where=where,
            what=f"is no key of the driver {driver!r}",
            remedy=suggestion(name, known),
        )
    if detail["type"] == "missing":
        return Problem(
            where=where,
            what=f"is missing; the driver {driver!r} needs it",
            remedy="see docs/drivers.md",
        )
    what, remedy = words(detail)
    return Problem(
        where=where, what=what, remedy=remedy.replace("datasets/README.md", "docs/drivers.md")
    )
