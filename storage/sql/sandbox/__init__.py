"""The process in which statements run, and its walls."""
