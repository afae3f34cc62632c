"""Commands of metrics, verdicts, limits and trends."""
