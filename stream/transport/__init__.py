"""The bus: one inside a process, and one over Zenoh."""
