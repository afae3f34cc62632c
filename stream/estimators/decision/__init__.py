"""Early decisions of screening tests."""
