"""A controller for the example's kind ``line``: an arm without inertia that is at its goal after one cycle."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

CYCLE_S = 0.02


class LineController:
    """Serves any number of links, one after the other or at once.

    Attributes
    ----------
    port : int
        On the loopback interface.
    commands : list of str
        All lines that were received.
    """

    def __init__(self, q: Sequence[float]) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self.commands: list[str] = []
        self._q = [str(float(value)) for value in q]
        self._moving = threading.Event()
        self._closed = threading.Event()
        self._links: list[socket.socket] = []

    def serve(self) -> None:
        """Accept links until ``close``."""
        with suppress(OSError):
            while not self._closed.is_set():
                link, _ = self._server.accept()
                self._links.append(link)
                threading.Thread(target=self._take, args=(link,), daemon=True).start()
                threading.Thread(target=self._send, args=(link,), daemon=True).start()

    def close(self) -> None:
        """Cut all links; no other will be accepted."""
        self._closed.set()
        for one in (self._server, *self._links):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def _take(self, link: socket.socket) -> None:
        with suppress(OSError, ValueError), link.makefile(encoding="ascii") as lines:
            for line in lines:
                self.commands.append(line.strip())
                verb, *numbers = line.split()
                if verb == "move":
                    self._moving.set()
                    self._q = numbers[2:]

    def _send(self, link: socket.socket) -> None:
        with suppress(OSError):
            while True:
                moving = self._moving.is_set()
                self._moving.clear()
                link.sendall(f"state {time.monotonic()} {int(moving)} {' '.join(self._q)}\n".encode("ascii"))
                if self._closed.wait(CYCLE_S):
                    return


@contextmanager
def line_controllers(*q: Sequence[float]) -> Iterator[tuple[LineController, ...]]:
    """Controllers whose arms stand at ``q`` (N,) [rad]."""
    controllers = tuple(LineController(one) for one in q)
    for one in controllers:
        threading.Thread(target=one.serve, daemon=True).start()
    try:
        yield controllers
    finally:
        for one in controllers:
            one.close()
