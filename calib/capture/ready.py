"""What must be known before rows can be captured: how good a reading is, and C2's lens."""

from __future__ import annotations

import math
from pathlib import Path

from calib.capture.description import Description
from calib.capture.guidance.need import Need
from calib.capture.intrinsics import lens_guide
from calib.capture.writer import GrowingFolder
from calib.core.errors import UsageError
from calib.dataset.lens_section import stated_camera
from calib.dataset.manifest import Manifest
from calib.geometry.camera import Camera
from calib.images.intrinsics.calibrate import MIN_VIEWS
from calib.rig.check_file import check_path, fit_check, read_check
from calib.rig.devices import RigDevices
from calib.rig.known import Role


def reading_uncertainty(rig: RigDevices, rig_file: Path | None) -> float:
    """Return the standard uncertainty of a reading, deg, as the check of the rig found it.

    Raises
    ------
    UsageError, RigError
        If the rig was never checked and rig.toml states none, or the check found it unfit.
    """
    where = check_path(rig_file)
    check = fit_check(where, serial=rig.serial)
    if check is None:
        stated = rig.settings.axis.u_alpha2_deg
        if stated is not None:
            return stated
        raise UsageError(
            f"{where}: is not there, and without it nobody knows how good a reading is; run "
            f"`calib rig check{f' {rig_file}' if rig_file else ''}` first"
        )
    return check.u_alpha2_deg


def return_uncertainty(rig: RigDevices, rig_file: Path | None) -> float:
    """Return the standard uncertainty with which C2 comes back to one reading, rad.

    As the check of the rig found it, the rounding of an encoder's count included; without a check
    it is that of any reading.
    """
    check = read_check(check_path(rig_file), serial=rig.serial)
    if check is None:
        return math.radians(reading_uncertainty(rig, rig_file))
    rounding = 0.0 if check.reads == "counts" else rig.axis.resolution_rad / math.sqrt(12)
    return math.hypot(math.radians(check.repeatability_deg), rounding)


def lens_c2(known: Description, manifest: Manifest | None, folder: GrowingFolder) -> Camera:
    """Return C2's lens: without it nothing can be centred; see `lens`.

    Raises
    ------
    UsageError
        If it is not known.
    """
    found = lens("c2", known, manifest, folder)
    if found is None:
        raise UsageError(
            "C2's lens is not known, so that targets cannot be centred; add matrix and distortion "
            "to [cameras.c2] of rig.toml, or run `calib capture intrinsics` into this dataset first"
        )
    return found


def lens(
    role: Role, known: Description, manifest: Manifest | None, folder: GrowingFolder
) -> Camera | None:
    """Return a camera's lens, from its own pictures, rig.toml or the dataset; None if none has it.

    Its own pictures come first, where enough of them were captured.
    """
    if known.board is not None and len(folder.pictures(f"intrinsics/{role}")) >= MIN_VIEWS:
        return lens_guide(folder, role, known.board, known.sizes[role], Need()).camera
    if role in known.lenses:
        return known.lenses[role]
    section = None if manifest is None else manifest.camera(role)
    return stated_camera(section, known.sizes[role])
