"""Error models in use on live signals."""
