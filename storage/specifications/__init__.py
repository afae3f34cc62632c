"""Product specifications as documents in the log."""
