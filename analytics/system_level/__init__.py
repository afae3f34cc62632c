"""System-level calibration of the scale-factor asymmetry of gyros by strapdown navigation (CN 102680005)."""
