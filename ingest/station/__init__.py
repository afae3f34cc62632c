"""A station: its instruments, units and clock, and the run of a procedure there."""
