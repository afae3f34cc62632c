"""Segments and lines of a power spectral density."""
