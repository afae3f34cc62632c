"""Work on many units by the executors of Apache Spark: each task opens its part of the store and runs the same code."""
