"""The report of a diagnosis: in words, in tables, in pictures, as one HTML file."""
