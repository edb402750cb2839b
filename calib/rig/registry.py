"""Drivers by name: entry points of the groups ``calib.cameras`` and ``calib.axes``.

A lab adds its own devices by a package of its own, without touching this one. A driver is a
callable that takes its section of rig.toml, a mapping, and returns a `Camera` or a `YawAxis`.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Final, cast

from calib.core.errors import InputError, UsageError
from calib.dataset.messages import shown, suggestion
from calib.rig.protocols import AxisDriver, CameraDriver

CAMERAS: Final = "calib.cameras"
AXES: Final = "calib.axes"

BUILT_IN: Final = (
    EntryPoint("virtual", "calib.rig.virtual.camera:open_camera", CAMERAS),
    EntryPoint("gige", "calib.rig.drivers.gige:open_camera", CAMERAS),
    EntryPoint("video", "calib.rig.drivers.video:open_camera", CAMERAS),
    EntryPoint("virtual", "calib.rig.virtual.axis:open_axis", AXES),
    EntryPoint("ximc", "calib.rig.drivers.ximc:open_axis", AXES),
)
"""Drivers that come with this package; they need no metadata of an installation."""


def camera_driver(name: str, *, where: str) -> CameraDriver:
    """Return the driver of a camera; `where` is the place that names it, for messages.

    Raises
    ------
    InputError
        If there is no such driver.
    UsageError
        If it cannot be imported, for want of the extra that it needs.
    """
    return cast(CameraDriver, _load(CAMERAS, name, where))


def axis_driver(name: str, *, where: str) -> AxisDriver:
    """Return the driver of a yaw axis; as `camera_driver`."""
    return cast(AxisDriver, _load(AXES, name, where))


def is_foreign(group: str, name: str) -> bool:
    """Return whether a driver comes from another package."""
    return name not in {point.name for point in BUILT_IN if point.group == group}


def _load(group: str, name: str, where: str) -> object:
    points = (*entry_points(group=group), *(p for p in BUILT_IN if p.group == group))
    found = {point.name: point for point in points}
    if name not in found:
        raise InputError.single(
            where=where,
            what=f"there is no driver {shown(name)}",
            remedy=suggestion(name, sorted(found)),
        )
    return _imported(found[name], where)


def _imported(point: EntryPoint, where: str) -> object:
    try:
        return point.load()
    except (ImportError, AttributeError, OSError) as error:
        raise UsageError(
            f"{where}: the driver {point.name!r} ({point.value}) cannot be loaded: {error}; "
            "install the extra or the package that it needs"
        ) from error
