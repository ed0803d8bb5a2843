"""The verb ``docs``."""
