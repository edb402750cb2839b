"""Gazing: C2 turned until it looks at the target that C1 sees, and what is then read."""
