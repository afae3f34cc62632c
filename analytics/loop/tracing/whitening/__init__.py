"""Blocks of a unit, the model of their noise, and regressions in the whitened space."""
