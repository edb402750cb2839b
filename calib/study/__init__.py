"""Studies: many simulated rigs, calibrated and scored against their truth."""
