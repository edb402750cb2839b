"""What is known of a rig before it is calibrated: its board, and lenses that rig.toml states.

A virtual camera brings its lens along, as a camera with a data sheet would.
"""

from __future__ import annotations

from typing import Literal

from calib.dataset.board_section import board_of
from calib.dataset.lens_section import stated_camera
from calib.geometry.board import Board
from calib.geometry.camera import Camera
from calib.rig.devices import RigDevices

Role = Literal["c1", "c2"]


def known_board(rig: RigDevices) -> Board | None:
    """Return the board of rig.toml, or the one before a virtual rig; None if there is none."""
    if rig.world is not None:
        return rig.world.board
    given = rig.settings.board
    return None if given is None else board_of(given)


def known_lens(rig: RigDevices, role: Role) -> Camera | None:
    """Return a camera's lens as far as it is known beforehand; None if it is not."""
    section, device = getattr(rig.settings.cameras, role), getattr(rig, role)
    given = stated_camera(section, device.image_size)
    if given is not None:
        return given
    if rig.world is not None and section.driver == "virtual":
        lens: Camera = getattr(rig.world.rig, role)
        return lens
    return None
