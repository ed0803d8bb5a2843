"""Mathematics of change: whether a calibration still holds, and trends over many runs."""
