"""From selected effects to a verdict: findings, alternatives, detection limits, caveats."""
