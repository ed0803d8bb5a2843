"""Dialogs over the screens. STOP is in the same corner, and the keys for stop and abort still work."""
