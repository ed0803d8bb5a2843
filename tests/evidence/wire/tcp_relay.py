"""A TCP relay in front of an emulated device: it can go silent, or be closed and refuse, as a computer could.

The device itself stays as it is, so that a fault of the way to it can be ended.
"""

from __future__ import annotations

import selectors
import socket
import threading
from types import TracebackType
from typing import Literal

Way = Literal["open", "silent", "closed"]

_CHUNK = 65536
_POLL_S = 0.005
"""How soon a change of the way is noticed."""
_CONNECTS_WITHIN_S = 2.0


class TcpRelay:
    """Listens on a port of its own and passes what comes in both directions, in a thread. A context manager."""

    def __init__(self, target: tuple[str, int], host: str = "127.0.0.1") -> None:
        """Listen at once; ``target`` is reached when a client connects."""
        self._target = target
        self._listening = socket.create_server((host, 0))
        self.host, self.port = self._listening.getsockname()[:2]
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listening, selectors.EVENT_READ)
        self._peers: dict[socket.socket, socket.socket] = {}
        self._asked: Way = "open"
        self._way: Way = "open"
        self._ended = False
        self._thread = threading.Thread(target=self._pass, daemon=True)

    def __enter__(self) -> TcpRelay:
        """Begin to pass."""
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close everything."""
        self._ended = True
        self._thread.join()
        self._close_all()
        self._listening.close()
        self._selector.close()

    def set(self, way: Way) -> None:
        """Change the way: ``silent`` takes and passes nothing, ``closed`` ends all connections and refuses new ones."""
        self._asked = way

    def _pass(self) -> None:
        while not self._ended:
            if self._asked != self._way:
                self._change(self._asked)
            if self._way == "silent":
                threading.Event().wait(_POLL_S)
                continue
            for key, _ in self._selector.select(_POLL_S):
                one = key.fileobj
                assert isinstance(one, socket.socket)
                if one is self._listening:
                    self._accept()
                elif one in self._peers:
                    self._forward(one)

    def _change(self, way: Way) -> None:
        if way == "closed":
            self._selector.unregister(self._listening)
            self._listening.close()
            self._close_all()
        elif self._way == "closed":
            self._listening = socket.create_server((self.host, self.port))
            self._selector.register(self._listening, selectors.EVENT_READ)
        self._way = way

    def _accept(self) -> None:
        client, _ = self._listening.accept()
        try:
            device = socket.create_connection(self._target, _CONNECTS_WITHIN_S)
        except OSError:
            client.close()
            return
        for one, other in ((client, device), (device, client)):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._peers[one] = other
            self._selector.register(one, selectors.EVENT_READ)

    def _forward(self, one: socket.socket) -> None:
        other = self._peers[one]
        try:
            data = one.recv(_CHUNK)
            if data:
                other.sendall(data)
                return
        except OSError:
            pass  # one side is gone: so is the other, below
        self._close(one)

    def _close(self, one: socket.socket) -> None:
        for end in (one, self._peers[one]):
            self._selector.unregister(end)
            del self._peers[end]
            end.close()

    def _close_all(self) -> None:
        while self._peers:
            self._close(next(iter(self._peers)))
