"""compensate."""
