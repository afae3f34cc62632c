"""Machine code of estimators: block sums and consecutive averages."""
