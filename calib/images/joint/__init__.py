"""Lenses of both cameras, pose of C2 and shape of the board in one least squares."""
