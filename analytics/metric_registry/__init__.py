"""The metrics there are: their headers, found in their files."""
