"""Conditions that a rule can have, one a file."""
