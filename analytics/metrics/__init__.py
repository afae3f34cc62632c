"""The characteristics of the test standards: one SQL file a metric, found by the registry."""
