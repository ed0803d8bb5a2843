"""The script port: program texts come in, and what can be run of them is handed to the controller.

Only whole blocks from ``def name():`` to an ``end`` in the first column are taken. URScript is not interpreted: the
control script of ur_rtde is recognised by its markers and acted out; any other program starts and ends at once. A real
controller also streams its state here; this one is silent.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from drivers.emulators.ur_controller.control_script import ControlScript
from drivers.emulators.ur_controller.controller import Controller, Program

_MOST_BYTES = 1 << 20
_HEAD = re.compile(rb"^def[ \t]+([A-Za-z_]\w*)[ \t]*\([^)\n]*\)[ \t]*:", re.MULTILINE)
_TAIL = re.compile(rb"^end[ \t]*\r?\n", re.MULTILINE)
_FLOAT_OFFSET = re.compile(rb"# ?float register offset\s*\n?\s*(\d+)")
_INT_OFFSET = re.compile(rb"# ?int register offset\s*\n?\s*(\d+)")


@dataclass
class UnknownProgram:
    """A program that is not understood: it starts and does nothing."""

    name: str

    def begin(self, controller: Controller) -> None:
        """Nothing."""

    def cycle(self, controller: Controller) -> bool:
        """It is over."""
        return False


def program_of(name: str, block: bytes) -> Program:
    """What a block of text does on a controller."""
    offsets = [pattern.search(block) for pattern in (_INT_OFFSET, _FLOAT_OFFSET)]
    numbers = [int(found.group(1)) for found in offsets if found is not None]
    if len(numbers) == 2 and all(number in (0, 24) for number in numbers):
        return ControlScript(*numbers)
    return UnknownProgram(name)


class Upload:
    """Collects the text of one connection and cuts programs out of it."""

    def __init__(self) -> None:
        self._held = bytearray()

    def take(self, data: bytes) -> list[Program]:
        """The programs that ``data`` completes, in order; text outside a program is dropped."""
        self._held += data
        found: list[Program] = []
        while (head := _HEAD.search(self._held)) is not None:
            tail = _TAIL.search(self._held, head.end())
            if tail is None:
                break
            block = bytes(self._held[head.start() : tail.end()])
            found.append(program_of(head.group(1).decode(), block))
            del self._held[: tail.end()]
        if head is None:
            del self._held[: self._held.rfind(b"\n") + 1]
        if len(self._held) > _MOST_BYTES:
            self._held.clear()
        return found
