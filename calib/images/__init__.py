"""Stages that start from board images: detection, intrinsics, stereo reference, yaw sweep."""
