"""How samples are kept: the event log (MCAP), the lake (Parquet) and SQL over it."""
