"""The verb ``check-certificate``."""
