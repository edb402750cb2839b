"""Sections of the report: each picks results and writes about them, or says None."""
