"""Verbs that only tests know: each is one file, and one word where it is added."""
