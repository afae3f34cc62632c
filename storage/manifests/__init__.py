"""Manifests: the segments of the log, and the parts of the lake that are in force."""
