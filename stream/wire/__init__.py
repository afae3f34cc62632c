"""Wire forms: sample batches, requests and acknowledgements, and what is refused on arrival."""
