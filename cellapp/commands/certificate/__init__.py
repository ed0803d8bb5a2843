"""The verb ``certificate``."""
