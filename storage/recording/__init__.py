"""From the bus to the log: the recorder, and what it answers to sources."""
