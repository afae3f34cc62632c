"""Alerts: conditions of a store that people are told of by e-mail or webhook, each once."""
