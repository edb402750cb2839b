"""The web page of a rig: one owner of motor and devices, any number who watch."""
