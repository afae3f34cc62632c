"""How a characteristic goes on from unit to unit and from day to day, and which group of units stands apart."""
