"""Gyros on serial lines."""
