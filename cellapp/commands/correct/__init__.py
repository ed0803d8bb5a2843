"""The verb ``correct``."""
