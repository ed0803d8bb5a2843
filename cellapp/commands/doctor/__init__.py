"""The verb ``doctor``."""
