"""Product specifications: limits of metrics, when they hold, and verdicts by them."""
