"""Script port: extracts programs from uploaded text and passes them to the controller.

Only complete blocks from ``def name():`` to an ``end`` in the first column count. URScript is not interpreted: the
control script of ur_rtde is recognised by its markers and emulated; any other program starts and ends at once. A real
controller also streams its state here; this one sends nothing.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from drivers.emulators.ur_controller.control_script import ControlScript
from drivers.emulators.ur_controller.controller import Controller
from drivers.emulators.ur_controller.program import Program

_MAX_BYTES = 1 << 20
_HEAD = re.compile(rb"^def[ \t]+([A-Za-z_]\w*)[ \t]*\([^)\n]*\)[ \t]*:", re.MULTILINE)
_TAIL = re.compile(rb"^end[ \t]*\r?\n", re.MULTILINE)
_FLOAT_OFFSET = re.compile(rb"# ?float register offset\s*\n?\s*(\d{1,9})\b")
_INT_OFFSET = re.compile(rb"# ?int register offset\s*\n?\s*(\d{1,9})\b")


@dataclass
class UnknownProgram:
    """A program that is not emulated: it starts and ends at once."""

    name: str

    def begin(self, controller: Controller) -> None:
        """Do nothing."""

    def cycle(self, controller: Controller) -> bool:
        """End."""
        return False


@dataclass
class ForeignProgram:
    """A program that a person loaded and started on the pendant; it moves nothing and does not end by itself."""

    name: str = "palletizing.urp"

    def begin(self, controller: Controller) -> None:
        """Do nothing."""

    def cycle(self, controller: Controller) -> bool:
        """Continue."""
        return True


def program_of(name: str, block: bytes) -> Program[Controller]:
    """Return the program of a block of text."""
    offsets = [pattern.search(block) for pattern in (_INT_OFFSET, _FLOAT_OFFSET)]
    numbers = [int(found.group(1)) for found in offsets if found is not None]
    if len(numbers) == 2 and all(number in (0, 24) for number in numbers):
        return ControlScript(*numbers)
    return UnknownProgram(name)


class Upload:
    """Collects the text of one connection and extracts programs."""

    def __init__(self) -> None:
        self._received = bytearray()

    def take(self, data: bytes) -> list[Program[Controller]]:
        """Return the programs that ``data`` completes, in order; text outside a program is discarded."""
        self._received += data
        found: list[Program[Controller]] = []
        while (head := _HEAD.search(self._received)) is not None:
            tail = _TAIL.search(self._received, head.end())
            if tail is None:
                break
            block = bytes(self._received[head.start() : tail.end()])
            found.append(program_of(head.group(1).decode(), block))
            del self._received[: tail.end()]
        if head is None:
            del self._received[: self._received.rfind(b"\n") + 1]
        if len(self._received) > _MAX_BYTES:
            self._received.clear()
        return found
