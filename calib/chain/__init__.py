"""The chain of a calibration: stages in their order, then the outputs."""
