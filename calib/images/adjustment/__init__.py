"""One adjustment of all pictures: lenses, board, rig, encoder and readings in one least squares."""
