"""Verbs that only tests know: each is one folder, and one line where it is added."""
