"""Attitudes of a unit: frames, positions, and what they compensate."""
