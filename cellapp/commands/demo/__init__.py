"""The verb ``demo``."""
