"""rig-check.json: what the check of a rig found, for gazing and for the manifests of captures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calib.core.errors import InputError
from calib.rig.protocols import RigError

FILE: Final = "rig-check.json"
LIMIT_BYTES: Final = 1_000_000

NotNegative = Annotated[float, Field(ge=0)]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Check(_Section):
    """One check and how it ended."""

    name: str
    passed: bool
    detail: str


class Devices(_Section):
    """Maker, model and serial number of each device."""

    c1: str
    c2: str
    axis: str


class FrameAge(_Section):
    """From the begin of the exposure to the hand of the program, median, ms."""

    c1: NotNegative
    c2: NotNegative


class RigCheck(_Section):
    """What the check of a rig found.

    `step_ratio` is the turn in C2's picture over the turn that is read; None without C2's lens.
    `u_alpha2_deg` is the standard uncertainty of a reading as rows are taken: at whole steps of the
    motor if `whole_steps`.
    """

    kind: Literal["calib rig check"] = "calib rig check"
    format: Literal[1] = 1
    serial: str
    time: str
    devices: Devices
    reads: Literal["load encoder", "motor encoder", "counts"]
    checks: tuple[Check, ...]
    direction: Literal[-1, 1]
    step_deg: NotNegative
    step_ratio: float | None
    backlash_deg: NotNegative
    backlash_steps: NotNegative
    settle_s: NotNegative
    frame_age_ms: FrameAge
    repeatability_deg: NotNegative
    u_reading_deg: NotNegative
    whole_steps: bool
    u_alpha2_deg: NotNegative

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that failed."""
        return tuple(check for check in self.checks if not check.passed)


def check_path(rig_file: Path | None) -> Path:
    """Return where the check of a rig lies: beside its rig.toml, or here for the virtual rig."""
    return Path(FILE) if rig_file is None else rig_file.with_name(FILE)


def check_text(check: RigCheck) -> str:
    """Return the file's text."""
    return json.dumps(check.model_dump(), indent=1) + "\n"


def read_check(path: Path, *, serial: str) -> RigCheck | None:
    """Return what a rig-check.json says; None if there is none.

    Parameters
    ----------
    serial
        Of the rig that is asked for.

    Raises
    ------
    InputError
        If it cannot be read, or is another rig's.
    """
    remedy = "run `calib rig check` again"
    try:
        with path.open("rb") as file:
            found = RigCheck.model_validate_json(file.read(LIMIT_BYTES))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError.single(
            where=str(path), what=f"cannot be read ({error.strerror})", remedy=remedy
        ) from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        what = f"{'.'.join(map(str, first['loc'])) or 'the file'}: {first['msg']}"
        raise InputError.single(where=str(path), what=what, remedy=remedy) from None
    if found.serial != serial:
        raise InputError.single(
            where=str(path), what=f"is of rig {found.serial}, not of {serial}", remedy=remedy
        )
    return found


def fit_check(path: Path, *, serial: str) -> RigCheck | None:
    """Return what a rig-check.json says of a rig that is fit; None if there is none.

    Raises
    ------
    RigError
        If the check found what spoils rows.
    InputError
        As `read_check`.
    """
    found = read_check(path, serial=serial)
    if found is not None and found.failed:
        details = "; ".join(f"{one.name}: {one.detail}" for one in found.failed)
        raise RigError(f"{path}: the rig is not fit: {details}; then run `calib rig check` again")
    return found
