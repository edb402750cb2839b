"""What a gaze row is worth: the position of its target, by a calibration."""

from __future__ import annotations

from collections.abc import Sequence
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
    """Return the position of a row's target and its uncertainty: `positions` of one row."""
    return positions(measuring, [row], model=model)


def positions(measuring: Measuring, rows: Sequence[GazeRow], *, model: str) -> Positions:
    """Return the positions of the targets of rows and their uncertainty, in order.

    The uncertainty of the pixels is that of the rows' own pictures, the largest of them, not the
    one of tables.

    Raises
    ------
    UsageError
        If the calibration has no such model, or the encoder was turned beyond (0, 180) deg.
    """
    degrees = np.degrees([row.standstill.reading_rad for row in rows])
    beyond = degrees[(degrees <= 0) | (degrees >= 180)]
    if len(beyond):
        raise UsageError(f"a reading of {beyond[0]:.3f} deg: readings are between 0 and 180 deg")
    pixel_c1 = np.array([row.pixel_c1 for row in rows])
    pixel_c2 = np.array([row.pixel_c2 for row in rows])
    table = reading_table(
        {
            "alpha2_deg": degrees,
            "u1_px": pixel_c1[:, 0],
            "v1_px": pixel_c1[:, 1],
            "u2_px": pixel_c2[:, 0],
        }
    )
    nothing = np.full(len(rows), np.nan)
    seen = ImageObservations(
        pixel_c1=pixel_c1,
        pixel_c2=pixel_c2,
        u_c1_px=max(row.u_c1_px for row in rows),
        u_c2_px=max(row.u_c2_px for row in rows),
        z_mm=nothing,
        u_z_mm=nothing,
        z_by_common=np.zeros((len(rows), measuring.setup.shared.factor.shape[1])),
    )
    return measure_by(measuring, table, model=model, seen=seen)
