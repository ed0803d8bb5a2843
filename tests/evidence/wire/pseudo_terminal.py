"""A program in a pseudo terminal, as a person at a keyboard has it. POSIX only."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import termios
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path

ENVIRONMENT = {"TERM": "xterm-256color", "COLORTERM": "truecolor"}
_SIZE_OF_ANOTHER = ("COLUMNS", "LINES")
"""Variables that programs prefer to the size of their terminal; the readline library sets them for child processes."""
_POLL_S = 0.2
_ENDS_WITHIN_S = 30.0
_KEPT = 200_000
"""Characters of what was drawn last that are kept."""
_CONTROLS = re.compile(
    r"\x1b(\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(\x07|\x1b\\)?|[()].|[@-Z\\^_=>78])|[\x00-\x08\x0b-\x1f]"
)


class PseudoTerminal:
    """A program in a pseudo terminal.

    Parameters
    ----------
    command : list of str
    folder : Path
        Where it runs.
    columns, rows : int
        Size of the terminal.
    environment : mapping
        What is added to the environment of this process.
    """

    def __init__(
        self,
        command: list[str],
        folder: Path,
        columns: int = 120,
        rows: int = 40,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._changed = threading.Condition()
        self._drawn = ""
        self._master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        inherited = {name: value for name, value in os.environ.items() if name not in _SIZE_OF_ANOTHER}
        self.began_s = time.monotonic()
        self.process = subprocess.Popen(
            command, cwd=folder, env={**inherited, **ENVIRONMENT, **(environment or {})}, stdin=slave, stdout=slave,
            stderr=slave, start_new_session=True, preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )  # fmt: skip
        os.close(slave)
        self._open = True
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        while self._open:
            ready, _, _ = select.select([self._master], [], [], _POLL_S)
            if not ready:
                continue
            try:
                data = os.read(self._master, 65536)
            except OSError:
                return  # the program has ended
            if not data:
                return
            with self._changed:
                self.take(data)
                self._changed.notify_all()

    def take(self, data: bytes) -> None:
        """Take in what the program drew; a subclass may keep a screen instead."""
        self._drawn = (self._drawn + data.decode(errors="replace"))[-_KEPT:]

    def text(self) -> str:
        """What was drawn since ``forget``, without places and colours; a word that was drawn in parts is in parts."""
        with self._changed:
            return self.shown()

    def shown(self) -> str:
        """As ``text``, for a subclass; the reading thread waits meanwhile."""
        return _CONTROLS.sub("", self._drawn)

    def forget(self) -> None:
        """Forget what was drawn so far."""
        with self._changed:
            self._drawn = ""

    def send(self, keys: str | bytes) -> float:
        """Type; return when [s] (``time.monotonic``), just before the first byte."""
        sent_s = time.monotonic()
        os.write(self._master, keys.encode() if isinstance(keys, str) else keys)
        return sent_s

    def until(self, holds: Callable[[str], bool], what: str, wait_s: float = 120.0) -> float:
        """Wait until the text satisfies a condition; return when [s].

        Raises
        ------
        TimeoutError
            If it never came; with the text.
        """
        end_s = time.monotonic() + wait_s
        with self._changed:
            while not holds(self.shown()):
                remaining_s = end_s - time.monotonic()
                if remaining_s <= 0.0 or not self._changed.wait(remaining_s):
                    raise TimeoutError(f"never came: {what}\n{self.shown()}")
        return time.monotonic()

    def quiet(self, for_s: float, times: float = 10.0) -> None:
        """Wait until nothing was drawn for some time, at most ``times`` as long: a job that runs always draws."""
        end_s = time.monotonic() + times * for_s
        with self._changed:
            while self._changed.wait(for_s) and time.monotonic() < end_s:
                pass

    def stall(self) -> None:
        """Read nothing any more, as a terminal behind a broken connection."""
        self._open = False
        self._reader.join()

    def hang_up(self) -> float:
        """Close the terminal, as a person closes its window; return when [s] (``time.monotonic``), just before."""
        self.stall()
        closed_s = time.monotonic()
        os.close(self._master)
        return closed_s

    def close(self) -> None:
        """End the program, whatever it does."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(_ENDS_WITHIN_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        if self._open:
            self.hang_up()
