"""Tables of samples: CSV and Parquet files that keep the import contract."""
