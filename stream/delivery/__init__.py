"""Numbered messages, kept by the source until a recorder has them on disk."""
