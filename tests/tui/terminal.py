"""The program in a real terminal: a pseudo terminal whose screen is kept by pyte. POSIX only."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pyte

ROOT = Path(__file__).resolve().parents[2]
WAIT_S = 120.0


class Terminal:
    """A program in a pseudo terminal. ``text`` is what a person sees; every change is awaited, none is slept for."""

    def __init__(self, command: list[str], folder: Path, columns: int = 120, rows: int = 40) -> None:
        self.screen = pyte.Screen(columns, rows)
        self._stream = pyte.ByteStream(self.screen)
        self._changed = threading.Condition()
        self._master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        environment = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor", "PYTHONPATH": str(ROOT)}
        self.began_s = time.monotonic()
        self.process = subprocess.Popen(
            command, cwd=folder, env=environment, stdin=slave, stdout=slave, stderr=slave, start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )  # fmt: skip
        os.close(slave)
        self._open = True
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        while self._open:
            ready, _, _ = select.select([self._master], [], [], 0.2)
            if not ready:
                continue
            try:
                data = os.read(self._master, 65536)
            except OSError:
                return  # the program has ended
            if not data:
                return
            with self._changed:
                self._stream.feed(data)
                self._changed.notify_all()

    def text(self) -> str:
        """The screen, a line for each of its lines."""
        with self._changed:
            return "\n".join(line.rstrip() for line in self.screen.display)

    def send(self, keys: str) -> float:
        """Type; return when [s]."""
        os.write(self._master, keys.encode())
        return time.monotonic()

    def until(self, holds: Callable[[str], bool], what: str, wait_s: float = WAIT_S) -> float:
        """Wait until the screen's text satisfies a condition; return when [s]."""
        end_s = time.monotonic() + wait_s
        with self._changed:
            while not holds("\n".join(self.screen.display)):
                left_s = end_s - time.monotonic()
                if left_s <= 0.0 or not self._changed.wait(left_s):
                    shown = "\n".join(line.rstrip() for line in self.screen.display)
                    raise AssertionError(f"never came: {what}\n{shown}")
        return time.monotonic()

    def quiet(self, for_s: float) -> None:
        """Wait until the screen has not changed for some time, at most ten times as long."""
        end_s = time.monotonic() + 10.0 * for_s
        with self._changed:
            while self._changed.wait(for_s) and time.monotonic() < end_s:
                pass

    def hang_up(self) -> None:
        """Close the terminal, as a person closes its window."""
        self._open = False
        self._reader.join()
        os.close(self._master)

    def close(self) -> None:
        """End the program, whatever it does."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(30.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        if self._open:
            self.hang_up()


@contextlib.contextmanager
def cellapp(folder: Path, columns: int = 120, rows: int = 40) -> Iterator[Terminal]:
    """The application in a terminal of a folder."""
    terminal = Terminal([sys.executable, "-m", "cellapp"], folder, columns, rows)
    try:
        yield terminal
    finally:
        terminal.close()
