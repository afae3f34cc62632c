"""Upkeep of the lake: the service, and retention of raw rows."""
