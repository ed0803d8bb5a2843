"""The verb ``discover``."""
