"""Tables of units of measure."""
