"""Control charts, the rules on them, and capability against a specification."""
