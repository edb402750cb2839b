"""What a gaze row is worth: the position of its target, by a calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.errors import InputError, UsageError
from calib.gaze.aim import FARTHER, NEARER, EpipolarAiming
from calib.gaze.row import GazeRow
from calib.geometry.camera import Camera
from calib.instrument.by_model import measure_by
from calib.instrument.calibration_file import Measuring
from calib.instrument.measuring import Positions
from calib.instrument.rig import reading_table
from calib.rig.devices import RigDevices
from calib.rows.from_table import ImageObservations


@dataclass(frozen=True)
class Lenses:
    """The lenses of a calibration, both known."""

    c1: Camera
    c2: Camera


def lenses(measuring: Measuring, rig: RigDevices, *, name: str) -> Lenses:
    """Return the lenses of a calibration that is this rig's.

    Parameters
    ----------
    name
        Of the calibration, for messages.

    Raises
    ------
    InputError
        If the calibration is of another rig, its cameras have other sizes, or it holds no lenses.
    """

    def refuse(what: str, remedy: str) -> InputError:
        return InputError.single(where=name, what=what, remedy=remedy)

    if measuring.serial is not None and measuring.serial != rig.serial:
        raise refuse(
            f"is the calibration of rig {measuring.serial}; the rig that is open is {rig.serial}",
            "give this rig's calibration, or the other rig.toml",
        )
    found = []
    for role in ("c1", "c2"):
        camera: Camera | None = getattr(measuring.setup.cameras, role)
        if camera is None:
            raise refuse(f"holds no lens of {role}", "calibrate a dataset with [cameras]")
        size = getattr(rig, role).image_size
        if camera.image_size != size:
            raise refuse(
                f"is for pictures of {role} of {camera.image_size[0]} x {camera.image_size[1]} px; "
                f"the camera gives {size[0]} x {size[1]}",
                "set the camera as it was calibrated, or calibrate again",
            )
        found.append(camera)
    return Lenses(*found)


def aiming(measuring: Measuring, c1: Camera) -> EpipolarAiming:
    """Return where a calibrated rig has to look for its targets."""
    near, far = measuring.calibrated_mm
    return EpipolarAiming(measuring.instrument.theta, c1, (NEARER * near, FARTHER * far))


def position(measuring: Measuring, row: GazeRow, *, model: str) -> Positions:
    """Return the position of a row's target and its uncertainty, one row.

    The uncertainty of the pixels is that of the row's own pictures, not the one of tables.

    Raises
    ------
    UsageError
        If the calibration has no such model, or the row's encoder was turned beyond (0, 180) deg.
    """
    degrees = float(np.degrees(row.standstill.reading_rad))
    if not 0 < degrees < 180:
        raise UsageError(f"a reading of {degrees:.3f} deg: readings are between 0 and 180 deg")
    one = np.ones(1)
    table = reading_table(
        {
            "alpha2_deg": degrees * one,
            "u1_px": row.pixel_c1[0] * one,
            "v1_px": row.pixel_c1[1] * one,
            "u2_px": row.pixel_c2[0] * one,
        }
    )
    nothing = np.full(1, np.nan)
    seen = ImageObservations(
        pixel_c1=row.pixel_c1[None],
        pixel_c2=row.pixel_c2[None],
        u_c1_px=row.u_c1_px,
        u_c2_px=row.u_c2_px,
        z_mm=nothing,
        u_z_mm=nothing,
        z_by_common=np.zeros((1, measuring.setup.shared.factor.shape[1])),
    )
    return measure_by(measuring, table, model=model, seen=seen)
