"""What each role reports of itself while it works: on the bus, in the store's folder, and to Prometheus."""
