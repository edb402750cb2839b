"""Geometry of active gazing: the turning gaze plane, its parameters, the pinhole camera."""
