"""Curves of recorded signals: Allan deviation, spectrum, and what is fitted to them."""
