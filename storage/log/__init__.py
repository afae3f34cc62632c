"""The append-only event log: segments written, sealed, recovered and read on."""
