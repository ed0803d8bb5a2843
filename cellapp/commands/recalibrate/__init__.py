"""recalibrate."""
