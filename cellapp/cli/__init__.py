"""The command line: the verbs, the trials, and what every command shares."""

from cellapp.cli.app import main

__all__ = ["main"]
