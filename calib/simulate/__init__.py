"""Rigs with known truth: tables of gazes, rendered images, whole datasets."""
