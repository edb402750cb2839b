"""What every room uses: array types, errors, gates; it knows nothing of calibration."""
