"""calibration.json as a model: what a run writes, what is read back, its JSON Schema."""
