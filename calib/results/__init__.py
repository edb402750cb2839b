"""The result of a calibration and its files: calibration.json, results.h5, the manifest."""
