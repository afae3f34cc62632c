"""Metrics evaluated over a store: tables in SQL, choices, and output for people."""
