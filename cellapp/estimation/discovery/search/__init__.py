"""Stepwise search for missing effects: scan of candidate laws, additions, refinements, extensions, review."""
