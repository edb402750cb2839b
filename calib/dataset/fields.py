"""Types of the manifest's values, with the slips of unit that betray themselves.

Each refuses by `refuse`, whose words reach the user unchanged (see `calib.dataset.faults`).
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date, datetime
from typing import Annotated, Final, NamedTuple, NoReturn

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field
from pydantic_core import PydanticCustomError

from calib.dataset.messages import shown, suggestion, text_fault
from calib.geometry.lens import ProjectionName, coefficients_fault
from calib.geometry.parameters import NAMES, REFERENCE_OFFSET

NOISE_PRIOR: Final = "log_noise_scale"
"""Prior on the natural logarithm of the factor on the stated standard uncertainties."""

PRIOR_NAMES = (*(name for name in NAMES if name != REFERENCE_OFFSET), NOISE_PRIOR)
"""From where z_mm counts is said by `z_from`."""

LARGEST_IMAGE_PX = 100_000
LARGEST_BOARD = 200

# Beyond one of these a value is a slip of unit, not a rig.
LARGEST_STEP_DEG = 10.0
LARGEST_U_FOCAL = 0.1
LARGEST_U_X1C = 0.05
LARGEST_U_Z_REL = 0.5
SMALLEST_SQUARE_MM = 0.5
SMALLEST_STEREO_BASELINE_MM = 1.0
LARGEST_PRIOR_RAD = 0.5

ROTATION_TOLERANCE = 0.002
"""Departure from a rotation that rounding to three decimals explains."""

REFUSED: Final = "refused"


def refuse(what: str, remedy: str) -> NoReturn:
    """Refuse a value in words meant for the user.

    Raises
    ------
    PydanticCustomError
        Always; pydantic adds the place and goes on to the next value.
    """
    raise PydanticCustomError(REFUSED, "{what}", {"what": what, "remedy": remedy})


def refuse_coefficients(
    projection: ProjectionName | None, distortion: tuple[float, ...] | None
) -> None:
    """Refuse a lens with a number of coefficients that its model, or OpenCV's, never has."""
    count = len(distortion or ())
    if fault := coefficients_fault(projection or "perspective", count):
        refuse(f"distortion has {count} coefficients", fault)


def _line(text: str) -> str:
    if fault := text_fault(text):
        refuse(f"{shown(text)} {fault}", "write one line of plain text")
    return text


def _prose(text: str) -> str:
    if fault := text_fault(text, one_line=False):
        refuse(f"{shown(text)} {fault}", "write plain text")
    return text


def _date(value: object) -> str:
    """Accept a TOML date as well as the same in quotes."""
    if isinstance(value, date) and not isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, str):
        try:
            return date.fromisoformat(value).isoformat()
        except ValueError:
            pass
    refuse(f"{shown(value)} is not a date", "write it as 2026-01-31")


def _country(text: str) -> str:
    if not (len(text) == 2 and text.isascii() and text.isalpha() and text.isupper()):
        refuse(f"{shown(text)} is not a country code", 'write two capitals, such as "DE"')
    return text


def _target(value: object) -> object:
    if value is None or value == "centre":
        return value
    match value:
        case [int(column), int(row)] if column >= 0 and row >= 0:
            return (column, row)
    refuse(
        f"{shown(value)} is no corner of a board",
        'write "centre", or [column, row] counted from 0',
    )


def _parameter(name: str) -> str:
    if name not in PRIOR_NAMES:
        refuse(f"unknown parameter {shown(name)}", suggestion(name, PRIOR_NAMES))
    return name


def _at_most(limit: float, *, unit: str, slip: str) -> AfterValidator:
    """Refuse values so large that they must be in another unit."""

    def check(value: float) -> float:
        if value > limit:
            refuse(f"{value:g} looks like {slip}", f"give it in {unit}")
        return value

    return AfterValidator(check)


def _in_mm(value: float) -> float:
    if value < SMALLEST_SQUARE_MM:
        refuse(f"{value:g} mm is hardly meant: metres?", "give it in millimetres")
    return value


Line = Annotated[str, AfterValidator(_line)]
Prose = Annotated[str, AfterValidator(_prose)]
Day = Annotated[str, BeforeValidator(_date)]
Country = Annotated[str, AfterValidator(_country)]
Flag = Annotated[bool, Field(strict=True)]
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Percent = Annotated[Number, Field(ge=0, le=100)]
AngleDeg = Annotated[Number, Field(gt=0, lt=180)]
Pixels = Annotated[int, Field(strict=True, gt=0, le=LARGEST_IMAGE_PX)]
CornerCount = Annotated[int, Field(strict=True, ge=2, le=LARGEST_BOARD)]
SquareMm = Annotated[Positive, AfterValidator(_in_mm)]
_STEP = _at_most(LARGEST_STEP_DEG, unit="degrees", slip="arc seconds or counts")
StepDeg = Annotated[Positive, _STEP]
UAngleDeg = Annotated[NotNegative, _STEP]
_X1C = _at_most(LARGEST_U_X1C, unit="parts of the focal length: pixels / fx", slip="pixels")
UX1c = Annotated[NotNegative, _X1C]
_FOCAL = _at_most(LARGEST_U_FOCAL, unit="parts of the focal length: 0.001 for 0.1 %", slip="pixels")
UFocal = Annotated[NotNegative, _FOCAL]
_REL = _at_most(LARGEST_U_Z_REL, unit="parts of z: 0.01 for 1 %", slip="per cent")
UZRel = Annotated[NotNegative, _REL]
DepthTolerance = Annotated[Positive, _REL]
Target = Annotated[tuple[int, int] | str | None, BeforeValidator(_target)]
ParameterName = Annotated[str, AfterValidator(_parameter)]

Row3 = tuple[Number, Number, Number]
Row4 = tuple[Number, Number, Number, Number]


def _camera_matrix(rows: tuple[Row3, Row3, Row3]) -> tuple[Row3, Row3, Row3]:
    (fx, skew, _), (zero, fy, _), last = rows
    if last != (0.0, 0.0, 1.0) or skew != 0 or zero != 0:
        refuse("is not of the form [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", "write it in this form")
    if min(fx, fy) <= 0:
        refuse(f"fx = {fx:g}, fy = {fy:g} are not positive", "check their signs")
    return rows


def _pose(rows: tuple[Row4, Row4, Row4, Row4]) -> tuple[Row4, Row4, Row4, Row4]:
    matrix = np.array(rows)
    rotation, translation = matrix[:3, :3], matrix[:3, 3]
    if rows[3] != (0.0, 0.0, 0.0, 1.0):
        refuse("its last row is not 0, 0, 0, 1", "give the pose of C2 in C1 as a 4 x 4 matrix")
    if np.max(np.abs(matrix)) > 1e6 or (
        np.max(np.abs(rotation @ rotation.T - np.eye(3))) > ROTATION_TOLERANCE
        or np.linalg.det(rotation) < 0
    ):
        refuse("its upper left 3 x 3 part is no rotation", "check its rows, signs and digits")
    if np.linalg.norm(translation) < SMALLEST_STEREO_BASELINE_MM:
        refuse(f"its translation {translation[0]:g} looks like metres", "give it in millimetres")
    return rows


CameraMatrix = Annotated[tuple[Row3, Row3, Row3], AfterValidator(_camera_matrix)]
Pose = Annotated[tuple[Row4, Row4, Row4, Row4], AfterValidator(_pose)]


class Prior(NamedTuple):
    """A normal prior, in the parameter's unit."""

    mean: Number
    std: Positive


def _angles_in_rad(priors: Mapping[str, Prior]) -> Mapping[str, Prior]:
    for name, prior in priors.items():
        if name.endswith("_rad") and max(abs(prior.mean), prior.std) > LARGEST_PRIOR_RAD:
            refuse(
                f"{name} = [{prior.mean:g}, {prior.std:g}] looks like degrees",
                "give it in radians",
            )
    return priors


PUBLISHED = (
    *(f"{camera}.{name}" for camera in ("c1", "c2") for name in ("fx", "fy", "cx", "cy")),
    *(f"c1_in_c2.rotation_{axis}_rad" for axis in "xyz"),
    *(f"c1_in_c2.translation_{axis}_mm" for axis in "xyz"),
)
"""Quantities whose published values a report can be held against: [value, standard uncertainty].

C1 in C2 is the pose that stereo toolboxes print: P2 = R P1 + t.
"""


def _published_name(name: str) -> str:
    if name not in PUBLISHED:
        refuse(f"unknown quantity {shown(name)}", suggestion(name, PUBLISHED))
    return name


Published = Mapping[Annotated[str, AfterValidator(_published_name)], Prior]

Priors = Annotated[Mapping[ParameterName, Prior], AfterValidator(_angles_in_rad)]
