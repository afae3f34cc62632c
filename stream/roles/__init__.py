"""Long-running roles: their settings in a file, their logs, and the supervision of their processes."""
