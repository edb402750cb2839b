"""What a page may ask for, each a JSON object with `do`."""

from __future__ import annotations

from typing import Annotated, Final, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from calib.core.errors import UsageError

Name = Annotated[str, Field(min_length=1, max_length=80)]

ROWS_MAX: Final = 500
GAZES_MAX: Final = 100
PIXELS_MAX: Final = 100_000


class _Command(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Check(_Command):
    """Check the rig."""

    do: Literal["check"]


class Capture(_Command):
    """Add rows to the dataset until the table has `count` of them."""

    do: Literal["capture"]
    kind: Literal["gaze", "validation"] = "gaze"
    count: Annotated[int, Field(ge=1, le=ROWS_MAX)] = 15
    target: Name = "board"


class Pictures(_Command):
    """Take pictures of the board, guided, until enough is known."""

    do: Literal["pictures"]
    kind: Literal["intrinsics", "stereo", "sweep"] = "intrinsics"


class Calibrate(_Command):
    """Run the chain on the dataset."""

    do: Literal["calibrate"]


class Gaze(_Command):
    """Measure the position of targets."""

    do: Literal["gaze"]
    count: Annotated[int, Field(ge=1, le=GAZES_MAX)] = 1
    target: Name = "board"


class Length(_Command):
    """Measure the distance of two points."""

    do: Literal["length"]
    start: Name
    end: Name


class Answer(_Command):
    """Answer the question that a job has asked."""

    do: Literal["answer"]
    text: Annotated[str, Field(max_length=40)] = ""


class Mark(_Command):
    """Mark another target in the pictures."""

    do: Literal["mark"]
    target: Name


class Pick(_Command):
    """Name the target at a place in a camera's picture, px, and mark it."""

    do: Literal["pick"]
    camera: Literal["c1", "c2"]
    u: Annotated[float, Field(ge=0, le=PIXELS_MAX)]
    v: Annotated[float, Field(ge=0, le=PIXELS_MAX)]


class Stop(_Command):
    """Stop the motor and forget what was to be done."""

    do: Literal["stop"]


class Take(_Command):
    """Take the motor, if nobody has it."""

    do: Literal["take"]


class Picture(_Command):
    """Send the next picture of a camera; one for each request."""

    do: Literal["picture"]
    camera: Literal["c1", "c2"]


Job: TypeAlias = Check | Capture | Pictures | Calibrate | Gaze | Length
"""What the worker does, one after the other."""

Command: TypeAlias = Job | Answer | Mark | Pick | Stop | Take | Picture

_ADAPTER: TypeAdapter[Command] = TypeAdapter(Annotated[Command, Field(discriminator="do")])

REPEATABLE: Final = (Gaze, Length)
"""Jobs that mean another one each time they are asked for."""

DRIVING: Final = (Check, Capture, Pictures, Gaze, Length)
"""Jobs that turn C2."""


def parse(text: str) -> Command:
    """Return the command in a message.

    Raises
    ------
    UsageError
        If there is none.
    """
    try:
        return _ADAPTER.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise UsageError(f"{place or 'message'}: {first['msg']}") from None
