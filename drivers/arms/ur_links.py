"""Plain TCP connections to a UR controller; a deadline (``time.monotonic``) limits every wait. IPv4 only."""

from __future__ import annotations

import errno
import ipaddress
import os
import queue
import selectors
import socket
import threading
import time
from typing import Self

from drivers.arms.protocol import LinkLost

DASHBOARD_PORT = 29999
PRIMARY_PORT = 30001
SCRIPT_PORT = 30003
RTDE_PORT = 30004

LOCAL_CONTROL = "the pendant is in local control"

_MAX_LINE = 4096
_READ_BYTES = 65536
_IN_PROGRESS = (errno.EINPROGRESS, errno.EWOULDBLOCK)


def resolve(host: str, deadline: float) -> str:
    """Return the IPv4 address of a host. A thread waits for the system's resolver, which has no time limit.

    Raises
    ------
    LinkLost
        If none is found by the deadline.
    """
    try:
        return str(ipaddress.IPv4Address(host))
    except ValueError:
        pass
    if not host.strip():
        raise LinkLost("the UR controller's host is empty; give its address as printable under Setup Robot > Network")
    answer: queue.SimpleQueue[str | None] = queue.SimpleQueue()

    def ask() -> None:
        try:
            found = socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_STREAM)
            answer.put(str(found[0][4][0]))
        except (OSError, ValueError):  # ValueError: the text cannot be a host name
            answer.put(None)

    threading.Thread(target=ask, name=f"resolve {printable(host)}", daemon=True).start()
    try:
        address = answer.get(timeout=remaining_s(deadline))
    except queue.Empty:
        address = None
    if address is None:
        raise LinkLost(
            f"{printable(host)}: no IPv4 host of that name was found; check the spelling, or give a numeric address"
        )
    return address


def remaining_s(deadline: float) -> float:
    """Return the seconds until the deadline, at least zero."""
    return max(0.0, deadline - time.monotonic())


def printable(text: str) -> str:
    """Return received text shortened and without control characters, for a message."""
    clean = "".join(c if c.isprintable() else "?" for c in text[:80])
    return f"{clean}..." if len(text) > 80 else clean


class Connection:
    """A TCP connection that is started at once and completes later. Use ``with`` to close it."""

    def __init__(self, host: str, address: str, port: int) -> None:
        self.port = port
        self.where = f"{host}:{port}"
        self._refusal: str | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        code = self._socket.connect_ex((address, port))
        if code not in (0, *_IN_PROGRESS):
            self._refusal = os.strerror(code)

    @classmethod
    def to(cls, host: str, port: int, deadline: float) -> Self:
        """Start a connection to a host by name or address. Raises ``LinkLost`` if there is no such host."""
        return cls(host, resolve(host, deadline), port)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; harmless when closed."""
        self._socket.close()

    def keep_alive(self) -> None:
        """Let the system notice within seconds that the peer or the cable is gone."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in (("TCP_KEEPIDLE", 1), ("TCP_KEEPINTVL", 1), ("TCP_KEEPCNT", 2)):
            if hasattr(socket, option):
                self._socket.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)

    def closed_by_peer(self) -> bool:
        """Return whether an idle connection has ended; bytes that nobody asked for end it too."""
        try:
            self._socket.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except OSError:
            return True
        return True

    def refusal(self, deadline: float) -> str:
        """Return why no connection was made by ``deadline``; empty if connected."""
        if self._refusal is None:
            if not self._wait(selectors.EVENT_WRITE, deadline):
                return "no answer in time"
            code = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            self._refusal = os.strerror(code) if code else ""
        return self._refusal

    def receive(self, deadline: float) -> bytes | None:
        """Return some bytes, empty if the peer closed, None if nothing came by ``deadline``. Raises ``OSError``."""
        if time.monotonic() >= deadline or not self._wait(selectors.EVENT_READ, deadline):
            return None
        return self._socket.recv(_READ_BYTES)

    def send(self, data: bytes, deadline: float) -> None:
        """Send a short text. Raises ``OSError``."""
        self._socket.settimeout(max(remaining_s(deadline), 1e-3))
        try:
            self._socket.sendall(data)
        finally:
            self._socket.setblocking(False)

    def _wait(self, event: int, deadline: float) -> bool:
        with selectors.DefaultSelector() as selector:
            selector.register(self._socket, event)
            return bool(selector.select(remaining_s(deadline)))


class Dashboard:
    """Dashboard server on a connection: one line per request and answer, of limited length.

    Attributes
    ----------
    deadline : float
        Limit of every wait (``time.monotonic``).

    Raises
    ------
    LinkLost
        If the peer's greeting is not that of a UR dashboard; also from the methods if it stops answering.
    """

    def __init__(self, link: Connection, deadline: float) -> None:
        self._link, self.deadline = link, deadline
        self._received = bytearray()
        refusal = link.refusal(deadline)
        if refusal:
            raise LinkLost(
                f"{link.where}: no connection to the UR dashboard ({refusal}); is the controller switched on, is this"
                " its address, and does the network between allow it?"
            )
        self.greeting = self._read("its greeting")
        if "universal robots dashboard" not in self.greeting.lower():
            raise LinkLost(
                f"{link.where}: the peer is not a UR dashboard: its greeting is '{printable(self.greeting)}';"
                " check the address"
            )

    def ask(self, line: str) -> str:
        """Send one line and return the answer."""
        try:
            self._link.send(f"{line}\n".encode("ascii"), self.deadline)
        except OSError as error:
            raise self._lost(f"the link broke while '{line}' was sent ({error})") from error
        return self._read(f"the answer to '{line}'")

    def _read(self, what: str) -> str:
        """Return the next line that is not empty; ``what`` names it in messages."""
        while True:
            end = self._received.find(b"\n", 0, _MAX_LINE)
            if end >= 0:
                line = self._received[:end].decode("utf-8", errors="replace").strip()
                del self._received[: end + 1]
                if line:
                    return line
                continue
            if len(self._received) >= _MAX_LINE:
                raise self._lost(f"{what} is longer than {_MAX_LINE} bytes; this is not a UR dashboard")
            try:
                more = self._link.receive(self.deadline)
            except OSError as error:
                raise self._lost(f"the link broke while waiting for {what} ({error})") from error
            if more is None:
                raise self._lost(f"connected, but {what} did not come in time")
            if not more:
                raise self._lost(f"the controller closed the connection before {what} came")
            self._received += more

    def _lost(self, what: str) -> LinkLost:
        return LinkLost(f"{self._link.where}: {what}; check the address; if it is right, restart the controller")


def stop_program(host: str, timeout_s: float, *, port: int = DASHBOARD_PORT) -> None:
    """Stop the controller's program over a separate dashboard connection: the arm brakes and rests.

    Raises
    ------
    LinkLost
        If it could not be reached within ``timeout_s``, or did not stop; the message says if it is in local control.
    """
    deadline = time.monotonic() + timeout_s
    with Connection.to(host, port, deadline) as link:
        require_stopped(Dashboard(link, deadline), host)


def require_stopped(dashboard: Dashboard, host: str) -> None:
    """Stop the program. Raises ``LinkLost`` as ``stop_program`` does."""
    answer = dashboard.ask("stop")
    # a controller without a running program reports a failure: it is stopped too
    if answer.startswith("Stopped") or dashboard.ask("running").lower().endswith("false"):
        return
    why = f"it answered '{printable(answer)}'"
    if dashboard.ask("is in remote control").lower() == "false":
        why = f"{LOCAL_CONTROL}, in which it takes no stop over the network"
    raise LinkLost(f"{host}: the controller did not stop its program: {why}")


def in_local_control(host: str, timeout_s: float, *, port: int = DASHBOARD_PORT) -> bool:
    """Return whether the pendant is in local control; False if the controller has no such switch or did not answer."""
    deadline = time.monotonic() + timeout_s
    try:
        with Connection.to(host, port, deadline) as link:
            return Dashboard(link, deadline).ask("is in remote control").lower() == "false"
    except LinkLost:
        return False
