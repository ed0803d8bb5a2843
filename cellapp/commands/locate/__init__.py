"""The verb ``locate``."""
