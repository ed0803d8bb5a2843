"""The verb ``compare``."""
