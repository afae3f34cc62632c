"""What is checked of a station: before a run, of the samples of its steps, and that it is left at rest."""
