"""Simulated instruments and gyros, for demonstrations and tests; their data are always declared as simulated."""
