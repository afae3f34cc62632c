"""Estimation while samples flow: from messages on the bus to estimates and early decisions."""
