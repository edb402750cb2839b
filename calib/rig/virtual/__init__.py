"""A rig with known truth behind the protocols of devices."""
