"""rig.toml, format 1: which devices make up the rig, and what they need.

Keys that are not named here belong to a device's driver, which checks them itself. Angles are in
degrees, as encoders read.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from calib.core.errors import InputError, Problem
from calib.dataset.faults import MANIFEST_LIMIT_BYTES, key_lines, parse_toml, words
from calib.dataset.fields import (
    AngleDeg,
    CameraMatrix,
    Line,
    NotNegative,
    Number,
    Pixels,
    StepDeg,
    refuse,
    refuse_coefficients,
)
from calib.dataset.folder import decode
from calib.dataset.manifest import BoardSection
from calib.dataset.messages import LISTED_PROBLEMS, shortened, shown, suggestion
from calib.dataset.section import Section
from calib.geometry.lens import ProjectionName
from calib.rig.virtual.settings import VirtualSettings

FILE: Final = "rig.toml"

EMBEDDED: Final = "the embedded virtual rig"
"""Name of the rig that is taken where there is no rig.toml."""


class _Device(BaseModel):
    """A section whose driver has keys of its own."""

    model_config = ConfigDict(frozen=True, extra="allow")
    driver: Line


class CameraSection(_Device):
    """A camera. `matrix` and `distortion` are a lens known beforehand, to gaze before calibrating.

    `projection` says of which lens model `distortion` is: "perspective" where it is left out.
    Without `image_size` the driver's own holds.
    """

    image_size: tuple[Pixels, Pixels] | None = None
    matrix: CameraMatrix | None = None
    distortion: tuple[Number, ...] = ()
    projection: ProjectionName | None = None

    @model_validator(mode="after")
    def _check_lens(self) -> CameraSection:
        if self.distortion and self.matrix is None:
            refuse("distortion is given without matrix", "give both, or neither")
        if self.projection is not None and self.matrix is None:
            refuse("projection is given without matrix", "give both, or neither")
        refuse_coefficients(self.projection, self.distortion)
        return self


def _range(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] < ends[1]:
        refuse(f"{ends[0]:g} to {ends[1]:g} is no range", "give the lower end first")
    return ends


class AxisSection(_Device):
    """The motor that turns C2.

    `resolution_deg` is one count of what is read, `step_deg` the motor's smallest move where an
    encoder is finer, `full_step_deg` a stepper's full step, in which microsteps repeat their error.
    """

    resolution_deg: StepDeg
    reads: Literal["load encoder", "motor encoder", "counts"]
    range_deg: Annotated[tuple[AngleDeg, AngleDeg], AfterValidator(_range)] = (40.0, 140.0)
    step_deg: StepDeg | None = None
    full_step_deg: StepDeg | None = None
    u_alpha2_deg: NotNegative | None = None

    @model_validator(mode="after")
    def _check_steps(self) -> AxisSection:
        step = self.step_deg or self.resolution_deg
        if self.full_step_deg is not None and self.full_step_deg < step:
            refuse(
                f"full_step_deg = {self.full_step_deg:g} is smaller than the motor's smallest "
                f"move, {step:g}",
                "give both at the yaw axis, in degrees",
            )
        return self


class CamerasSection(Section):
    """The monitor camera C1 and the gazing camera C2."""

    c1: CameraSection
    c2: CameraSection


class RigSettings(Section):
    """A whole rig.toml.

    `baseline_mm` is the distance of C2's yaw axis from C1 by a tape measure, negative where C2
    stands on the left: by it targets are looked for before the rig is calibrated.
    """

    format: Literal[1]
    serial: Line
    baseline_mm: Number | None = None
    cameras: CamerasSection
    axis: AxisSection
    board: BoardSection | None = None
    virtual: VirtualSettings = Field(default_factory=VirtualSettings)

    @property
    def nominal_baseline_mm(self) -> float | None:
        """The baseline by tape measure, or the one that a virtual rig is told to have, mm."""
        if self.baseline_mm is not None:
            return self.baseline_mm
        return self.virtual.parameters.get("baseline_mm")

    @property
    def devices(self) -> Mapping[str, CameraSection | AxisSection]:
        """The sections that name a driver, by their place in the file."""
        return {"cameras.c1": self.cameras.c1, "cameras.c2": self.cameras.c2, "axis": self.axis}


def embedded() -> RigSettings:
    """Return the settings of the embedded virtual rig: no hardware, no file."""
    camera = {"driver": "virtual", "image_size": (640, 480)}
    axis = {
        "driver": "virtual",
        "resolution_deg": 0.009,
        "step_deg": 0.05625,
        "full_step_deg": 0.9,
        "reads": "load encoder",
    }
    settings = {
        "format": 1,
        "serial": "virtual-1",
        "cameras": {"c1": camera, "c2": camera},
        "axis": axis,
        "virtual": {"seed": 1, "baseline_mm": 200.0},
    }
    return RigSettings.model_validate(settings)


def read_settings(path: Path | None) -> RigSettings:
    """Return the settings in a rig.toml; None gives the embedded virtual rig.

    Raises
    ------
    InputError
        With at most ten of its faults.
    """
    if path is None:
        return embedded()
    try:
        with path.open("rb") as file:
            data = file.read(MANIFEST_LIMIT_BYTES + 1)
    except OSError as error:
        raise InputError.single(
            where=str(path),
            what=f"cannot be read ({error.strerror})",
            remedy="give a rig.toml, or leave it out for the virtual rig",
        ) from None
    return parse_settings(data, name=str(path))


def parse_settings(data: bytes, *, name: str = FILE) -> RigSettings:
    """Return the settings in the bytes of a rig.toml.

    Raises
    ------
    InputError
        With at most ten of its faults.
    """
    if len(data) > MANIFEST_LIMIT_BYTES:
        raise InputError.single(
            where=name, what="is too large to be a rig.toml", remedy="see docs/rig.md for one"
        )
    text = decode(data, where=name)
    raw = parse_toml(text, file=name)
    try:
        return RigSettings.model_validate(raw)
    except ValidationError as error:
        details = error.errors(include_url=False)
        lines = key_lines(text)
        problems = [_problem(d, lines, name) for d in details[:LISTED_PROBLEMS]]
        raise InputError(shortened(problems, where=name, total=len(details))) from None


def rig_schema() -> dict[str, Any]:
    """Return the JSON Schema of rig.toml."""
    return RigSettings.model_json_schema()


_EXAMPLES: Mapping[str, str] = {
    "format": "format = 1",
    "serial": 'serial = "rig-07", the name of the rig',
    "driver": 'driver = "virtual", or the name of another',
    "resolution_deg": "resolution_deg = 0.05625, one count of what is read",
    "reads": 'reads = "load encoder", "motor encoder" or "counts"',
    "axis": "a section [axis]",
    "cameras": "sections [cameras.c1] and [cameras.c2]",
    "c1": "a section [cameras.c1]",
    "c2": "a section [cameras.c2]",
}


def _problem(error: ErrorDetails, lines: Mapping[tuple[str, ...], int], name: str) -> Problem:
    names = tuple(part for part in error["loc"] if isinstance(part, str) and part != "[key]")
    if error["type"] == "extra_forbidden":
        what, remedy = f"unknown key {shown(names[-1])}", suggestion(names[-1], _known(names[:-1]))
    elif error["type"] == "missing":
        what, remedy = "is missing", f"add {_EXAMPLES.get(names[-1], 'it') if names else 'it'}"
    elif names == ("format",):
        what = f"{shown(error['input'])} is no format of rig.toml that this version reads"
        remedy = "write format = 1"
    else:
        what, remedy = words(error)
    return Problem(where=_where(names, lines, name), what=what, remedy=_own(remedy))


def _own(remedy: str) -> str:
    return remedy.replace("datasets/README.md", "docs/rig.md")


def _known(path: tuple[str, ...]) -> list[str]:
    sections: Mapping[tuple[str, ...], type[BaseModel]] = {
        ("cameras",): CamerasSection,
        ("board",): BoardSection,
    }
    return list(sections.get(path, RigSettings).model_fields)


def _where(names: tuple[str, ...], lines: Mapping[tuple[str, ...], int], name: str) -> str:
    if not names:
        return name
    *sections, key = names
    place = f"{name}, [{'.'.join(sections)}] {key}" if sections else f"{name}, {key}"
    for depth in range(len(names), 0, -1):
        if names[:depth] in lines:
            return f"{place} (line {lines[names[:depth]]})"
    return place
