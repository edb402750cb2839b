"""Board corners in pictures."""
