"""Commands of the closed loop: diagnosis, models and compensation."""
