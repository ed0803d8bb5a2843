"""The verb ``recalibrate``."""
