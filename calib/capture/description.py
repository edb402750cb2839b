"""dataset.toml of a capture: written at the first row, and held against the rig at later ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import tomli_w
from pydantic import ValidationError

from calib.capture.writer import MANIFEST, GrowingFolder
from calib.core.errors import InputError
from calib.dataset.board_section import section_of
from calib.dataset.faults import parse_toml
from calib.dataset.lens_section import camera_section
from calib.dataset.manifest import Manifest
from calib.geometry.board import Board
from calib.geometry.camera import Camera
from calib.rig.devices import RigDevices
from calib.rig.known import Role, known_board, known_lens
from calib.rig.settings import AxisSection

Kind = Literal["gaze", "validation"]

SMALLEST_NAME: Final = "capture"


@dataclass(frozen=True)
class Description:
    """What a capture knows of the rig and of its references.

    Parameters
    ----------
    serial, is_left
        Of the rig.
    lenses
        Of "c1" and "c2" as far as they are known.
    sizes
        Of their pictures, px.
    board
        Of rig.toml, None without.
    resolution_deg, u_alpha2_deg
        A count of what is read and the standard uncertainty of a reading.
    motor
        What a manifest says of the readings besides.
    reference
        What the depths are.
    z_from_c1
        Whether depths count from C1's optical centre.
    """

    serial: str
    is_left: bool
    lenses: dict[Role, Camera]
    sizes: dict[Role, tuple[int, int]]
    board: Board | None
    resolution_deg: float
    u_alpha2_deg: float
    motor: Mapping[str, Any]
    reference: str
    z_from_c1: bool


def describe(rig: RigDevices, *, u_alpha2_deg: float) -> Description:
    """Return what is known of a rig before its calibration."""
    roles: tuple[Role, ...] = ("c1", "c2")
    known = {role: known_lens(rig, role) for role in roles}
    is_virtual = rig.world is not None
    baseline = rig.settings.nominal_baseline_mm
    return Description(
        serial=rig.serial,
        is_left=baseline is not None and baseline < 0,
        lenses={role: lens for role, lens in known.items() if lens is not None},
        sizes={"c1": rig.c1.image_size, "c2": rig.c2.image_size},
        board=known_board(rig),
        resolution_deg=rig.settings.axis.resolution_deg,
        u_alpha2_deg=u_alpha2_deg,
        motor=_motor(rig.settings.axis),
        reference="ruler, simulated" if is_virtual else "measured by hand",
        z_from_c1=is_virtual,
    )


def _motor(axis: AxisSection) -> Mapping[str, Any]:
    """Return what a manifest says of the readings beside their uncertainty."""
    full = {} if axis.full_step_deg is None else {"full_step_deg": axis.full_step_deg}
    return {"reads": axis.reads, **full}


def read_manifest(folder: GrowingFolder) -> Manifest | None:
    """Return the manifest that a folder has already; None if it has none.

    Raises
    ------
    InputError
        If it is damaged.
    """
    text = folder.text(MANIFEST)
    if text is None:
        return None
    raw = parse_toml(text, file=MANIFEST)
    try:
        return Manifest.model_validate(raw)
    except ValidationError as error:
        raise _bad(
            f"has {error.error_count()} fault(s)", f"see `calib check {folder.root}`, mend them"
        ) from None


def refuse_other(manifest: Manifest, known: Description) -> None:
    """Refuse to add rows of this rig to the dataset of another.

    Raises
    ------
    InputError
        With what differs.
    """
    new = "capture into a new folder"
    if manifest.rig.serial is not None and manifest.rig.serial != known.serial:
        raise _bad(f"is of rig {manifest.rig.serial}, the open one is {known.serial}", new)
    if manifest.encoder is not None and manifest.encoder.resolution_deg != known.resolution_deg:
        raise _bad(
            f"[encoder] resolution_deg is {manifest.encoder.resolution_deg:g}, that of the rig is "
            f"{known.resolution_deg:g}",
            new,
        )
    for role, size in known.sizes.items():
        section = manifest.camera(role)
        if section is not None and section.image_size not in (None, size):
            raise _bad(f"[cameras.{role}] image_size is not the camera's, {list(size)}", new)


def add_sections(folder: GrowingFolder, known: Description, kind: Kind, table: str) -> None:
    """Add to the manifest what the rows of a table need and it does not say; what stands stays."""
    add_tables(folder, _sections(known, kind, table, root=folder.root))


def add_tables(folder: GrowingFolder, wanted: Mapping[str, Any]) -> None:
    """Add to the manifest what it does not say; what stands stays.

    Parameters
    ----------
    wanted
        Keys and tables of a manifest.
    """
    text = folder.text(MANIFEST)
    present = {} if text is None else parse_toml(text, file=MANIFEST)
    missing = {key: value for key, value in wanted.items() if key not in present}
    cameras = present.get("cameras")
    if isinstance(cameras, dict):
        more = {role: s for role, s in wanted.get("cameras", {}).items() if role not in cameras}
        missing |= {"cameras": more} if more else {}
    if not missing:
        return
    if text is None:
        folder.write_text(MANIFEST, tomli_w.dumps(missing))
        return
    # Keys before tables: only tables can be added to the end of a file.
    tables = {key: value for key, value in missing.items() if isinstance(value, dict)}
    folder.write_text(MANIFEST, text.rstrip("\n") + "\n\n" + tomli_w.dumps(tables))


def head_tables(known: Description, root: Path) -> dict[str, Any]:
    """Return what a manifest of the rig begins with."""
    return {
        "format": 1,
        "name": _name(root),
        "title": f"Captured by rig {known.serial}",
        "rig": {"c2": "left" if known.is_left else "right", "serial": known.serial},
    }


def board_tables(board: Board) -> dict[str, Any]:
    """Return the section of a board."""
    return {"board": section_of(board)}


def encoder_tables(known: Description) -> dict[str, Any]:
    """Return the section of the encoder."""
    return {
        "encoder": {
            "resolution_deg": known.resolution_deg,
            "u_alpha2_deg": known.u_alpha2_deg,
            **known.motor,
        }
    }


def _name(root: Path) -> str:
    return root.resolve().name or SMALLEST_NAME


def _sections(known: Description, kind: Kind, table: str, *, root: Path) -> dict[str, Any]:
    rows: dict[str, Any] = {"table": table, "reference": known.reference}
    if known.z_from_c1:
        rows["z_from"] = "c1"
    boards = {} if known.board is None else board_tables(known.board)
    return {
        **head_tables(known, root),
        "cameras": {role: _camera(known, role) for role in known.lenses},
        **encoder_tables(known),
        kind: rows,
        **boards,
    }


def _camera(known: Description, role: Role) -> dict[str, Any]:
    lens = known.lenses[role]
    return camera_section(lens)


def _bad(what: str, remedy: str) -> InputError:
    return InputError.single(where=MANIFEST, what=what, remedy=remedy)
