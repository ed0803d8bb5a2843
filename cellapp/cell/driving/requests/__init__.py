"""Requests to a running job from other processes."""
