"""SQL over the plants of a fleet store."""
