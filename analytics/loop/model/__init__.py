"""Error models: their text, coefficients, versions, and which is in use."""
