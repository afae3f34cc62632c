"""Live CAN buses."""
