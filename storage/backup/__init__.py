"""Backups of a store: made while it is written, verified, incremental; restored with the same identity."""
