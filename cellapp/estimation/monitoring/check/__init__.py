"""Mathematics of the ten-minute check: predictions of a calibration, choice of stops, a sequential test."""
