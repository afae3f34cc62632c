"""Import of files into a store, each sample once."""
