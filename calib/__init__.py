"""Calibration of active-gazing stereo: a fixed monitor camera and a yawing, gazing one.

>>> import calib
>>> rig = calib.load("reports/my-rig/calibration.json")            # doctest: +SKIP
>>> points = rig.measure(x1c=[0.1], y1c=[0.05], alpha2_deg=[86.4])  # doctest: +SKIP

Nothing heavy is imported before a name below is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from calib.core.version import __version__

if TYPE_CHECKING:
    from calib.chain.start import FinishedRun as Calibrated
    from calib.chain.start import calibrate as calibrate
    from calib.core.errors import CalibError as CalibError
    from calib.core.errors import InputError as InputError
    from calib.core.errors import UsageError as UsageError
    from calib.instrument.rig import FailedGates as FailedGates
    from calib.instrument.rig import Points as Points
    from calib.instrument.rig import Rig as Rig
    from calib.instrument.rig import load as load

_HOMES = {
    "CalibError": "calib.core.errors",
    "Calibrated": "calib.chain.start",
    "FailedGates": "calib.instrument.rig",
    "InputError": "calib.core.errors",
    "Points": "calib.instrument.rig",
    "Rig": "calib.instrument.rig",
    "UsageError": "calib.core.errors",
    "calibrate": "calib.chain.start",
    "load": "calib.instrument.rig",
}

__all__ = [
    "CalibError",
    "Calibrated",
    "FailedGates",
    "InputError",
    "Points",
    "Rig",
    "UsageError",
    "__version__",
    "calibrate",
    "load",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'calib' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *_HOMES]
