"""CAN: frames, databases, logs, and from frames to samples."""
