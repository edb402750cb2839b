"""Estimators of the gaze model: one a file."""
