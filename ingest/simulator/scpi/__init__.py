"""Simulated instruments that speak SCPI."""
