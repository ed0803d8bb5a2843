"""The verb ``sign-key``, and its keys."""
