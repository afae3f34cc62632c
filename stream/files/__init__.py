"""Files: written at once, and those that a site adds to the program."""
