"""Uncertainty budgets (JJF 1059.1 = JCGM 100, JCGM 101): components, their propagation, coverage, rounding."""
