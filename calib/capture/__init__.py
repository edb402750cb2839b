"""Capture: what the rig sees and reads, written into a dataset row by row."""
