"""What every metric stands on: one record for each signal of each step of each unit."""
