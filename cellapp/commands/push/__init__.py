"""The verb ``push``."""
