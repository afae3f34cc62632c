"""Noise coefficients from an Allan curve."""
