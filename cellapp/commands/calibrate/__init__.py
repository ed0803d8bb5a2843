"""The verb ``calibrate``."""
