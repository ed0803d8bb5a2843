"""The whole program, as a start without a command builds it."""

from __future__ import annotations

from cellapp.interfaces.cli.app import program

app = program()
