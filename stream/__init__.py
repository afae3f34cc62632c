"""What a sample is, how it travels, and what is known while it flows."""
