"""Test procedures: what is commanded, settled and recorded, as data in TOML."""
