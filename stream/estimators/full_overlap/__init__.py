"""Deviations of finished records with full overlap."""
