"""Machine code of the estimators."""
