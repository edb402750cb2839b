"""Where the board is to be held next: pictures chosen by what they make known."""
