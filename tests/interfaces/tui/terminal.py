"""The program in a real terminal: a pseudo terminal whose screen is kept by pyte. POSIX only."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pyte

from tests.evidence.wire.pseudo_terminal import PseudoTerminal

ROOT = Path(__file__).resolve().parents[3]
PATIENT = "tests.interfaces.tui.patient_program"
"""The application beside emulated arms on a busy computer."""


class Terminal(PseudoTerminal):
    """A program in a pseudo terminal. ``text`` is what a person sees, a line for each line of the screen."""

    def __init__(
        self, command: list[str], folder: Path, columns: int = 120, rows: int = 40, **environment: str
    ) -> None:
        self.screen = pyte.Screen(columns, rows)
        self._stream = pyte.ByteStream(self.screen)
        super().__init__(command, folder, columns, rows, {"PYTHONPATH": str(ROOT), **environment})

    def take(self, data: bytes) -> None:
        """Draw."""
        self._stream.feed(data)

    def shown(self) -> str:
        """The screen, a line for each of its lines."""
        return "\n".join(line.rstrip() for line in self.screen.display)


@contextlib.contextmanager
def cellapp(folder: Path, program: str = "cellapp") -> Iterator[Terminal]:
    """The application, or ``PATIENT``, in a terminal of a folder."""
    terminal = Terminal([sys.executable, "-m", program], folder)
    try:
        yield terminal
    finally:
        terminal.close()
