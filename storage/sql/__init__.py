"""SQL over a store: its views, and the process in which statements of users run."""
