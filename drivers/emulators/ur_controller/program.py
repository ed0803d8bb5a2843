"""What a controller executes: a program, one control cycle at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from drivers.emulators.ur_controller.controller import Controller


class ScriptError(Exception):
    """A program requests something impossible; the program ends."""


class Program(Protocol):
    """A program on a controller, executed one cycle at a time."""

    name: str

    def begin(self, controller: Controller) -> None:
        """Execute the first step. Raises ``ScriptError``."""

    def cycle(self, controller: Controller) -> bool:
        """Execute one control cycle; return whether the program continues. Raises ``ScriptError``."""
