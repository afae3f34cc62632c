"""Upkeep of the lake: compaction in rounds, and retention of raw rows."""
