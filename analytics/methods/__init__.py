"""Computations that metrics share and SQL cannot express."""
