"""How samples come in: instruments, files, simulated stations."""
