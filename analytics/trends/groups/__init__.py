"""Comparison of stations, fixtures and lots by a mixed model."""
