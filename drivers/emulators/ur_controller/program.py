"""Interface of the programs that a controller executes, one control cycle at a time."""

from __future__ import annotations

from typing import Protocol, TypeVar

C = TypeVar("C", contravariant=True)
"""The controller that executes a program."""


class ScriptError(Exception):
    """A program requested something impossible; the program ends."""


class Program(Protocol[C]):
    """A program on a controller, executed one cycle at a time."""

    name: str

    def begin(self, controller: C) -> None:
        """Execute the first step. Raises ``ScriptError``."""

    def cycle(self, controller: C) -> bool:
        """Execute one control cycle; return whether the program continues. Raises ``ScriptError``."""
