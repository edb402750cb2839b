"""Calibration of active-gazing stereo: a fixed monitor camera and a yawing, gazing one."""

__version__ = "0.1.0"
