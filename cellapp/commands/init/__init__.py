"""The verb ``init``."""
