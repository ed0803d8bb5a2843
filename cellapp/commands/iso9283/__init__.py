"""The verb ``iso9283``."""
