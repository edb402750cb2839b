"""Intrinsics of one camera, by OpenCV and by mrcal."""
