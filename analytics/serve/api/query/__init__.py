"""Signals, curves and SQL over the HTTP API, also as a data source of Grafana."""
