"""Figures of the report: results in, a matplotlib figure with its data out."""
