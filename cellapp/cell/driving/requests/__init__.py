"""Requests to a running job from other processes, and watching it."""
