"""The verb ``at-rest``."""
