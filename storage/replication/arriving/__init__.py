"""Segments and files that arrive: fetched within a bandwidth, checked, and visible only then."""
