"""calibration.json filled from results: each file returns parts of its model, `calib.document`."""
