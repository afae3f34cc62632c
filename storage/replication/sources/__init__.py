"""Where replication reads a plant: a folder, or an endpoint of the bus."""
