"""The verb ``plan``."""
