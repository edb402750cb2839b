"""Calibration of active-gazing stereo."""

__version__ = "0.1.0"
