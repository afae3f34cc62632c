"""The append-only event log: writing, sealing, recovering and reading segments."""
