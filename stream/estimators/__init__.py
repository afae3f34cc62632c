"""What is known of a signal while it flows: one concept a file, one protocol for all (``base``)."""
