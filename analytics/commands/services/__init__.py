"""Commands of pages, their users, alerts, settings and the demo."""
