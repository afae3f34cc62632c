"""Changes of level: of one series, and of all units of a session at once."""
