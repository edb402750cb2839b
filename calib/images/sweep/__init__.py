"""The yaw sweep: where the axis of C2 stands."""
