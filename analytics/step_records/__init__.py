"""Step records, the input of every metric: one for each signal of each step of each unit."""

FOLDER = "metrics"  # folder in a store in which records and metrics are kept
