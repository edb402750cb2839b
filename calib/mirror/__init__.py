"""A rig with C2 on the left is calibrated as its mirror image: rows go in, results come back."""
