"""The verb ``rehearse``."""
