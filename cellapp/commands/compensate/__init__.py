"""The verb ``compensate``."""
