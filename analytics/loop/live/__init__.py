"""Error models applied to live signals."""
