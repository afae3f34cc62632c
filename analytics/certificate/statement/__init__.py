"""What a certificate states: the order, what the store knows, results with U, item by item of a standard."""
