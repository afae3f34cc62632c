"""Manifests: which segments the log has, and which parts of the lake are in force."""
