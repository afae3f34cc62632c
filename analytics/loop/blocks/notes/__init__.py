"""What was left out of the blocks of a run, and why."""
