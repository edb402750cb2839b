"""Many datasets at once: each calibrated by itself, with one summary of all."""
