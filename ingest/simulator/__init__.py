"""Instruments that are physics and arithmetic: for demonstrations and tests, always declared as simulated."""
