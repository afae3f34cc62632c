"""Physics of the gyros of a simulated station: what is planted, written apart from everything that looks for it."""
