"""The verb ``follow``."""
