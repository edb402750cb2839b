"""Runs side by side: whether the rig has drifted."""
