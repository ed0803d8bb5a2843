"""The verb ``greet``."""
