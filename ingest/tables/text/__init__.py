"""Tables of text: CSV and its like."""
