"""Tracing the residual of an error model to the effect that it lacks."""
