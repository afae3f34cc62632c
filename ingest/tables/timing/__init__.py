"""Times of tables: the grid of samples, dates and times of day in two columns, remarks on them."""
