"""The verb ``touch``."""
