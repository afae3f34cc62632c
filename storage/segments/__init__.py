"""MCAP segments: their records, how they are read, and the disk below them."""
