"""Gaze rows as observations with covariance: from tables, from images, with common errors."""
