"""The verb ``tracker-bridge``."""
