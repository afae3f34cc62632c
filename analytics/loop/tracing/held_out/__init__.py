"""Predictions of the held-out runs: slopes that confirm or refuse effects, and errors before and after."""
