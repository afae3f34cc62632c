"""Commands of what samples mean."""
