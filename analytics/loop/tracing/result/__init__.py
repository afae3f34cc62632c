"""The result of a diagnosis as data, and its JSON."""
