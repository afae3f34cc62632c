"""Replication: sealed segments of plants, verified at arrival, in a fleet store."""
