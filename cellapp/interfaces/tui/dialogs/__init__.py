"""Questions over the screens. STOP is in the same corner, and the keys that stop and abort work over them, too."""
