"""Runs of live sources, and stored runs sent once more."""
