"""Files brought into a store, each sample once."""
