"""Alerts: conditions of a store that are reported to people by e-mail or webhook, each once."""
