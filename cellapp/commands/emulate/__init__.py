"""The verb ``emulate``."""
