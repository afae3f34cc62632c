"""Physics of simulated gyros, written independently of the code that looks for the planted effects."""
