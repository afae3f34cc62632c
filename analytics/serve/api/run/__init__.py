"""Runs over the HTTP API: steps, course, live Allan deviation, commands."""
