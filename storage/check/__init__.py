"""Whether a store is what was written to it, and how it is put right."""
