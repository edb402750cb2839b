"""The version, of the distribution and of whatever a run writes."""

__version__ = "0.1.0"
