"""The calibrated instrument: how it is built, read back from its file, and measures."""
