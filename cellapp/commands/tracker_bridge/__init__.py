"""tracker bridge."""
