"""Verbs beside the pipeline: each reads from a run, calls pure functions, and appends what they made."""
