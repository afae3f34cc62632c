"""Calibrations that SQL cannot say."""
