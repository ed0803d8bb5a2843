"""Ports and connections with injectable faults. One thread, one selector."""

from __future__ import annotations

import os
import random
import selectors
import socket
import struct
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal, Protocol, get_args

Fault = Literal["none", "silent", "refuse", "garbage", "flood", "trickle"]
FAULTS: tuple[Fault, ...] = get_args(Fault)
Ending = Literal["fin", "rst"]

_GARBAGE = b"\x00\xff\x17 this is no robot \xfe\x80\n"
_CHUNK = 65536
_FLOOD = 4096
_MAX_CLIENTS = 64
_MAX_QUEUED = 1 << 20
_MAX_STREAMED = 1 << 16
_MAX_FD = 1000  # select() accepts at most 1024
_TRICKLE_S = 0.05
_SENT_AGAIN_S = 0.2
"""After this time TCP sends a lost message again [s]."""
_MOST_UNREAD = 64
"""Chunks that are read from a client whose connection ends; a client that keeps sending is reset."""


class LinkService(Protocol):
    """Protocol handler of one connection."""

    def received(self, data: bytes) -> None:
        """Process bytes from the client."""

    def closed(self) -> None:
        """Release resources after the connection has ended."""


@dataclass(eq=False)
class Peer:
    """One connection to a port."""

    port: Port
    socket: socket.socket
    session: LinkService | None = None
    queued: bytearray = field(default_factory=bytearray)
    closing: bool = False
    gone: bool = False
    travelling: deque[tuple[float, bool, bytes]] = field(default_factory=deque)
    """Messages on the way, in order: when each arrives, whether it comes from the client, and itself."""

    def send(self, data: bytes) -> None:
        """Queue an answer, subject to the port's fault."""
        match self.port.fault:
            case "none":
                self.port.pass_on(self, data, received=False)
            case "garbage":
                self.port.push(self, _GARBAGE)
            case "flood":
                self.port.push(self, b"")
            case _:
                pass

    def stream(self, data: bytes) -> None:
        """Queue unsolicited data; dropped for a client that does not read."""
        if self.port.fault == "none" and len(self.queued) < _MAX_STREAMED:
            self.port.pass_on(self, data, received=False)
        elif self.port.fault == "garbage":
            self.port.push(self, _GARBAGE)

    def close_after_send(self) -> None:
        """Close after all queued data are sent."""
        self.closing = True
        self.port.push(self, b"")


class Port:
    """One listening port, its connections and its current fault.

    ``open_session`` returns the handler of a new connection. ``network`` is the delay of every message, each way [s],
    and the share of lost ones, which are sent again; what follows on the same connection waits for them.
    """

    def __init__(
        self, selector: selectors.BaseSelector, host: str, number: int, open_session: Callable[[Peer], LinkService]
    ) -> None:
        self._selector = selector
        self.host = host
        self.number = number
        self._open_session = open_session
        self._listening: socket.socket | None = None
        self.links: list[Peer] = []
        self.fault: Fault = "none"
        self.network = (0.0, 0.0)
        self._random = random.Random(number)
        self._fault_end_s: float | None = None
        self._trickle_at_s = 0.0

    def listen(self) -> None:
        """Listen on the port. Raises ``OSError`` that names the address."""
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            if os.name == "posix":  # on Windows it would share the port with another process
                listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind((self.host, self.number))
            listening.listen(16)
            listening.setblocking(False)
        except OSError as error:
            listening.close()
            raise OSError(error.errno, f"cannot listen on {self.host}:{self.number}: {error.strerror}") from error
        self.number = listening.getsockname()[1]
        self._listening = listening
        self._selector.register(listening, selectors.EVENT_READ, self)

    def close(self) -> None:
        """Drop all connections and free the port."""
        for link in list(self.links):
            self.drop(link)
        if self._listening is not None:
            self._selector.unregister(self._listening)
            self._listening.close()
            self._listening = None

    def fail(self, fault: Fault, until_s: float | None = None) -> None:
        """Set a fault, until ``until_s`` if given. Raises ``OSError`` if a refused port was taken meanwhile."""
        if fault == "refuse":
            self.close()
        elif self._listening is None:
            self.listen()
        self.fault = fault
        self._fault_end_s = until_s
        for link in list(self.links):
            self._update_events(link)

    def tick(self, now_s: float) -> None:
        """End a fault that is due; send the bytes of a trickle."""
        if self._fault_end_s is not None and now_s >= self._fault_end_s:
            with suppress(OSError):  # the port was taken meanwhile: it stays refused
                self.fail("none")
        for link in list(self.links):
            while link.travelling and link.travelling[0][0] <= now_s and not link.gone:
                _, received, data = link.travelling.popleft()
                self._arrive(link, data, received=received)
        if self.fault == "trickle" and now_s >= self._trickle_at_s:
            self._trickle_at_s = now_s + _TRICKLE_S
            for link in list(self.links):
                self.push(link, b"\x00")

    def accept(self) -> None:
        """Accept a new connection."""
        if self._listening is None:
            return
        try:
            connection, _ = self._listening.accept()
        except OSError:
            return  # the client has closed already
        if len(self.links) >= _MAX_CLIENTS or connection.fileno() > _MAX_FD:
            connection.close()
            return
        connection.setblocking(False)
        with suppress(OSError):  # some systems refuse it once the client has gone
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link = Peer(self, connection)
        self.links.append(link)
        self._selector.register(connection, selectors.EVENT_READ, link)
        self._update_events(link)
        link.session = self._open_session(link)

    def handle(self, link: Peer, events: int) -> None:
        """Read and write as the selector reports."""
        if link.gone:
            return
        if events & selectors.EVENT_READ:
            try:
                data = link.socket.recv(_CHUNK)
            except BlockingIOError:
                data = None
            except OSError:
                data = b""
            if data == b"":
                self.drop(link)
                return
            if data:
                self.pass_on(link, data, received=True)
        if events & selectors.EVENT_WRITE and not link.gone:
            self.push(link, b"")

    def pass_on(self, link: Peer, data: bytes, *, received: bool) -> None:
        """Let a message from the client (``received``) or to it arrive after its way through the network."""
        delay_s, loss = self.network
        if not (delay_s or loss or link.travelling):
            self._arrive(link, data, received=received)
            return
        arrives_s = time.monotonic() + delay_s + (_SENT_AGAIN_S if self._random.random() < loss else 0.0)
        latest_s = link.travelling[-1][0] if link.travelling else 0.0
        link.travelling.append((max(arrives_s, latest_s), received, data))

    def _arrive(self, link: Peer, data: bytes, *, received: bool) -> None:
        if not received:
            self.push(link, data)
        elif link.session is not None:
            link.session.received(data)

    def push(self, link: Peer, data: bytes) -> None:
        """Queue bytes and send at once what the socket accepts."""
        if link.gone:
            return
        flood = self.fault == "flood"
        link.queued += data
        if flood and len(link.queued) < _FLOOD:
            link.queued += b"x" * _FLOOD
        try:
            sent = link.socket.send(link.queued) if link.queued else 0
        except BlockingIOError:
            sent = 0
        except OSError:
            self.drop(link)
            return
        del link.queued[:sent]
        if len(link.queued) > _MAX_QUEUED or (link.closing and not link.queued):
            self.drop(link)
            return
        if link.queued or sent < len(data) or flood:
            self._update_events(link)

    def _update_events(self, link: Peer) -> None:
        """Register the selector events of a connection; a silent one is not read either, like a cut cable."""
        events = 0 if self.fault == "silent" else selectors.EVENT_READ
        if link.queued or self.fault == "flood":
            events |= selectors.EVENT_WRITE if self.fault != "silent" else 0
        registered = link.socket in self._selector.get_map()
        if events and registered:
            self._selector.modify(link.socket, events, link)
        elif events:
            self._selector.register(link.socket, events, link)
        elif registered:
            self._selector.unregister(link.socket)

    def drop(self, link: Peer, ending: Ending = "fin") -> None:
        """End a connection in an orderly way, or with a reset."""
        if link.gone:
            return
        link.gone = True
        self.links.remove(link)
        if link.socket in self._selector.get_map():
            self._selector.unregister(link.socket)
        with suppress(OSError):
            if ending == "rst":
                link.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            else:
                for _ in range(_MOST_UNREAD):  # unread bytes would turn the end into a reset
                    if not link.socket.recv(_CHUNK):
                        break
        if ending == "fin":
            with suppress(OSError):
                link.socket.shutdown(socket.SHUT_WR)
        link.socket.close()
        if link.session is not None:
            link.session.closed()
