"""Units over the HTTP API: runs, curves, certificates, error models, diagnosis."""
