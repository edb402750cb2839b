"""Drivers of real devices. Each file needs an extra of its own, told in docs/drivers.md."""
