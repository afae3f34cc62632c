"""The floor as it is now, from the log; its changes as server-sent events."""
