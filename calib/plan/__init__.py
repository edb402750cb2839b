"""Where to put the next targets."""
