"""The verb ``fleet``."""
