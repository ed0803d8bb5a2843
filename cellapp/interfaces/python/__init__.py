"""A run from Python, as plain objects and data frames."""
