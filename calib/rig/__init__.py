"""The rig itself: its cameras and yaw axis through protocols, real or simulated."""
