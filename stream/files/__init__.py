"""Files: written at once, read as TOML, and those that a site adds to the program."""
