"""Trends over the HTTP API: charts, their pictures."""
