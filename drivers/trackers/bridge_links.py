"""Sockets of the bridge server: one selector loop over a TCP listener, its connections and a serial port.

Nothing here blocks. All limits that protect the server against broken or hostile peers are here: length of a line, time
to finish a line, time to open a session, bytes queued for a peer that does not read, number of connections.
"""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, Protocol

import serial

from drivers.trackers.bridge_wire import LONGEST_LINE

LOG = logging.getLogger(__name__)

NEVER_S = -1e9
"""A time before any reading of the monotonic clock."""
JOIN_S = 5.0
"""How long ``close`` waits for a thread. A thread that hangs in a driver must not keep the program alive."""
_READ_BYTES = 8192
_MAX_QUEUED_BYTES = 65536
"""Limit of unread replies per peer: 32 lines of the greatest length."""
_LOG_INTERVAL_S = 1.0
_REOPEN_SERIAL_S = 2.0
_SERIAL_OPENS_WITHIN_S = 2.0
"""How long ``start`` waits for a serial port to open. After that it opens in the background; earlier input is lost."""

SessionState = Literal["new", "challenged", "holding"]


@dataclass(eq=False)
class Link:
    """One connection: its socket, its buffers, and the state of its session.

    Attributes
    ----------
    permanent : bool
        Whether this is the serial port, which cannot be hung up.
    received, queued : bytearray
        Start of an unfinished line; bytes that the peer has not read yet.
    skipping : bool
        Whether input is discarded up to the next line end, because a line was too long.
    line_start_s, last_line_s : float
        When the unfinished line began; when the last valid line arrived.
    closing : bool
        Whether output was shut down; the link ends when the peer hangs up or the time limit is over.
    """

    socket: socket.socket
    peer: str
    permanent: bool
    opened_s: float
    last_line_s: float
    state: SessionState = "new"
    client: str = ""
    nonce: str = ""
    received: bytearray = field(default_factory=bytearray)
    queued: bytearray = field(default_factory=bytearray)
    skipping: bool = False
    line_start_s: float = 0.0
    last_notice_s: float = NEVER_S
    bad_lines: int = 0
    closing: bool = False


class LinkHandler(Protocol):
    """Callbacks for events on the links. All calls come from the thread that calls ``LinkServer.poll``."""

    def accepts_connections(self) -> bool:
        """Return whether new connections are accepted now; if not, they are closed at once."""

    def line_received(self, link: Link, raw: bytes) -> None:
        """Handle one line without its line end; it may be damaged."""

    def bad_line(self, link: Link, reason: str) -> None:
        """Handle input that cannot become a line."""

    def session_ended(self, link: Link, reason: str) -> None:
        """Release everything that the session on this link holds."""


class RateLimitedLog:
    """Log of at most one warning a second of each kind, so that a hostile peer cannot fill the disk."""

    def __init__(self) -> None:
        self._logged: dict[str, tuple[float, int]] = {}

    def warning(self, message: str, *details: object) -> None:
        """Log a warning or count it as omitted; ``message`` is a format for ``details`` and identifies the kind."""
        now = time.monotonic()
        last_s, left_out = self._logged.get(message, (NEVER_S, 0))
        if now - last_s < _LOG_INTERVAL_S:
            self._logged[message] = last_s, left_out + 1
            return
        more = f" (and {left_out} more like it)" if left_out else ""
        self._logged[message] = now, 0
        LOG.warning(message + more, *details)


class LinkServer:
    """Accepts connections, splits their input into lines and queues output. Call ``open``, then ``poll`` repeatedly.

    Attributes
    ----------
    links : list of Link
        Every open link, oldest first.
    """

    def __init__(self, handler: LinkHandler, *, hello_s: float, line_s: float, max_links: int) -> None:
        """Limits: ``hello_s`` until a session is open, ``line_s`` per line, ``max_links`` without a session."""
        self._handler = handler
        self._hello_s, self._line_s, self._max_links = hello_s, line_s, max_links
        self.links: list[Link] = []
        self._actions: deque[Callable[[], None]] = deque()
        self._selector: selectors.BaseSelector | None = None
        self._listener: socket.socket | None = None
        self._wake_send: socket.socket | None = None
        self._wake_receive: socket.socket | None = None
        self._serial: _SerialPump | None = None
        self._closed = False

    def open(self, host: str, port: int | None, serial_url: str | None, baud: int) -> int | None:
        """Listen and return the TCP port. Raises ``OSError`` if the address is not available; then nothing is open."""
        with contextlib.ExitStack() as stack:
            self._selector = stack.enter_context(selectors.DefaultSelector())
            self._wake_send, self._wake_receive = socket.socketpair()
            for end in (self._wake_send, self._wake_receive):
                stack.enter_context(end)
                end.setblocking(False)
            self._selector.register(self._wake_receive, selectors.EVENT_READ)
            if port is not None:
                self._listener = stack.enter_context(_listen(host, port))
                self._selector.register(self._listener, selectors.EVENT_READ)
                port = int(self._listener.getsockname()[1])
            if serial_url is not None:
                ours, theirs = socket.socketpair()
                self._add(ours, "the serial port", permanent=True)
                self._serial = _SerialPump(serial_url, baud, theirs)
                self._serial.start()
            stack.pop_all()
        return port

    def close(self) -> None:
        """Hang up all links and close all ports."""
        self._closed = True
        if self._serial is not None:
            self._serial.close()
        for link in list(self.links):
            self.drop(link, "the bridge is closed", at_once=True)
        for end in (self._listener, self._wake_send, self._wake_receive, self._selector):
            if end is not None:
                end.close()
        self._listener = self._wake_send = self._wake_receive = None

    def wake(self) -> None:
        """Make a waiting ``poll`` return; from any thread."""
        wake = self._wake_send
        if wake is not None:
            with contextlib.suppress(OSError):  # full: poll wakes anyway; closed: no thread waits
                wake.send(b"\0")

    def call_soon(self, action: Callable[[], None]) -> None:
        """Run ``action`` in the thread of ``poll``; from any thread."""
        self._actions.append(action)
        self.wake()

    def poll(self, timeout_s: float = 0.0) -> None:
        """Handle all pending input once; wait for it at most ``timeout_s``."""
        assert self._selector is not None, "open it first"
        for key, _ in self._selector.select(timeout_s):
            if key.fileobj is self._wake_receive:
                with contextlib.suppress(BlockingIOError):
                    self._wake_receive.recv(4096)
            elif key.fileobj is self._listener:
                self._accept()
            elif key.data in self.links:  # handling another link may have dropped it
                self._read(key.data)
        while self._actions:
            self._actions.popleft()()

    def enforce_limits(self) -> None:
        """Send queued output; end lines and links that have exceeded their time limit."""
        now = time.monotonic()
        for link in list(self.links):
            if link.queued and not link.closing:
                self._flush(link)
            if (link.received or link.skipping) and now - link.line_start_s > self._line_s:
                link.received.clear()
                link.skipping = False
                self._handler.bad_line(link, f"a line was not finished within {self._line_s:g} s")
            if link.closing:
                if now - link.last_line_s > self._hello_s:
                    self._hang_up(link)
            elif link.state != "holding" and not link.permanent and now - link.opened_s > self._hello_s:
                self.drop(link, f"no session was opened within {self._hello_s:g} s", at_once=True)

    def send(self, link: Link, line: bytes) -> None:
        """Queue a line. The link of a peer that leaves too much unread is dropped."""
        link.queued += line
        if len(link.queued) > _MAX_QUEUED_BYTES:
            link.queued.clear()
            self.drop(link, "the client does not read its answers", at_once=True)
            return
        self._flush(link)

    def drop(self, link: Link, reason: str, *, at_once: bool = False) -> None:
        """End the session, then the link. Queued output may still arrive unless ``at_once``; a serial port stays."""
        if link not in self.links:
            return
        self._handler.session_ended(link, reason)
        link.state, link.client, link.bad_lines = "new", "", 0
        if link.permanent and not self._closed:
            return
        if at_once or link.closing:
            self._hang_up(link)
            return
        link.closing = True
        link.last_line_s = time.monotonic()
        self._flush(link)
        if link in self.links:
            with contextlib.suppress(OSError):  # the peer may have hung up
                link.socket.shutdown(socket.SHUT_WR)

    def _add(self, opened: socket.socket, peer: str, *, permanent: bool) -> None:
        assert self._selector is not None
        opened.setblocking(False)
        now = time.monotonic()
        link = Link(opened, peer, permanent, opened_s=now, last_line_s=now)
        self.links.append(link)
        self._selector.register(opened, selectors.EVENT_READ, link)

    def _accept(self) -> None:
        assert self._listener is not None
        try:
            opened, address = self._listener.accept()
        except OSError:  # the peer has hung up already, or no file descriptors are left
            return
        if not self._handler.accepts_connections():
            opened.close()
            return
        without_session = [link for link in self.links if link.state != "holding" and not link.permanent]
        if len(without_session) >= self._max_links:
            self.drop(without_session[0], "there are too many connections", at_once=True)
        with contextlib.suppress(OSError):
            opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._add(opened, f"{address[0]}:{address[1]}", permanent=False)

    def _read(self, link: Link) -> None:
        try:
            data = link.socket.recv(_READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self.drop(link, f"the link broke: {error.strerror}", at_once=True)
            return
        if not data:
            self.drop(link, "the client hung up", at_once=True)
            return
        if link.closing:
            return
        if not link.received and not link.skipping:
            link.line_start_s = time.monotonic()
        link.received += data
        self._split_lines(link)

    def _split_lines(self, link: Link) -> None:
        while link in self.links and not link.closing:
            raw, end, rest = link.received.partition(b"\n")
            if not end:
                break
            link.received = rest
            link.line_start_s = time.monotonic()
            if link.skipping:
                link.skipping = False
            else:
                self._handler.line_received(link, bytes(raw))
        if len(link.received) >= LONGEST_LINE:
            link.received.clear()
            if not link.skipping:
                link.skipping = True
                self._handler.bad_line(link, f"the line is longer than {LONGEST_LINE} bytes")

    def _flush(self, link: Link) -> None:
        try:
            sent = link.socket.send(link.queued)
        except BlockingIOError:
            return
        except OSError as error:
            self.drop(link, f"the link broke: {error.strerror}", at_once=True)
            return
        del link.queued[:sent]

    def _hang_up(self, link: Link) -> None:
        if link in self.links:
            self.links.remove(link)
            assert self._selector is not None
            self._selector.unregister(link.socket)
            link.socket.close()


def _listen(host: str, port: int) -> socket.socket:
    """Return a listening, non-blocking socket. Raises ``OSError`` that names the address."""
    with contextlib.ExitStack() as stack:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = stack.enter_context(socket.socket(family, socket.SOCK_STREAM))
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, port))
            listener.listen(512)
        except OSError as error:
            raise OSError(error.errno, f"cannot listen at {host} port {port}: {error.strerror}") from error
        listener.setblocking(False)
        stack.pop_all()
    return listener


class _SerialPump:
    """Copies bytes between a serial port and one end of a socket pair; reopens a lost port."""

    def __init__(self, url: str, baud: int, end: socket.socket) -> None:
        self._url, self._baud, self._end = url, baud, end
        self._closing = threading.Event()
        self._tried = threading.Event()
        self._thread = threading.Thread(target=self._run, name="tracker bridge, serial", daemon=True)

    def start(self) -> None:
        """Start the thread; return when the port is open or opening it has failed."""
        self._thread.start()
        self._tried.wait(_SERIAL_OPENS_WITHIN_S)

    def close(self) -> None:
        self._closing.set()
        self._thread.join(JOIN_S)
        self._end.close()

    def _run(self) -> None:
        self._end.setblocking(False)
        while not self._closing.is_set():
            try:
                with serial.serial_for_url(self._url, baudrate=self._baud, timeout=0.02, write_timeout=2.0) as port:
                    LOG.info("serving %s", self._url)
                    self._tried.set()
                    self._copy(port)
            except (serial.SerialException, OSError, ValueError) as error:
                LOG.warning("%s: %s; retrying", self._url, error)
                self._tried.set()
                self._closing.wait(_REOPEN_SERIAL_S)

    def _copy(self, port: serial.SerialBase) -> None:
        while not self._closing.is_set():
            data = port.read(1)
            if data:
                data += port.read(min(port.in_waiting, _READ_BYTES))
                with contextlib.suppress(BlockingIOError):  # input that the server does not read in time is lost
                    self._end.send(data)
            with contextlib.suppress(BlockingIOError):
                waiting = self._end.recv(_READ_BYTES)
                if waiting:
                    port.write(waiting)
