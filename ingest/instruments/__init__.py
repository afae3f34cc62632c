"""One file an instrument."""
