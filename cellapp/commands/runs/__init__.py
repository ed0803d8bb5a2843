"""The verb ``runs``."""
