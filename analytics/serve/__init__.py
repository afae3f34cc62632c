"""The server: pages and an HTTP API over a store, with users, roles and live state."""
