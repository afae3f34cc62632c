"""The columnar lake: parts of Parquet files made from sealed segments."""
