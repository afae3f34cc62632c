"""What the samples mean: curves, limits, verdicts, fleet tables."""
