"""Plain TCP links to a UR controller, each wait bounded by a deadline (a value of ``time.monotonic``). IPv4 only."""

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

_LONGEST_LINE = 4096
_MOST_AT_ONCE = 65536
_UNDER_WAY = (errno.EINPROGRESS, errno.EWOULDBLOCK)


def resolve(host: str, deadline: float) -> str:
    """The IPv4 address of a host. The system's resolver knows no timeout, so a thread waits for it.

    Raises
    ------
    LinkLost
        If there is none by the deadline.
    """
    try:
        return str(ipaddress.IPv4Address(host))
    except ValueError:
        pass
    if not host.strip():
        raise LinkLost("the UR controller's host is empty; give its address as shown under Setup Robot > Network")
    answer: queue.SimpleQueue[str | None] = queue.SimpleQueue()

    def ask() -> None:
        try:
            found = socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_STREAM)
            answer.put(str(found[0][4][0]))
        except (OSError, ValueError):  # ValueError: a text that can be no host name
            answer.put(None)

    threading.Thread(target=ask, name=f"resolve {shown(host)}", daemon=True).start()
    try:
        address = answer.get(timeout=left(deadline))
    except queue.Empty:
        address = None
    if address is None:
        raise LinkLost(
            f"{shown(host)}: no IPv4 host of that name was found; check the spelling, or give the address as numbers"
        )
    return address


def left(deadline: float) -> float:
    """Seconds until the deadline, not below zero."""
    return max(0.0, deadline - time.monotonic())


def shown(text: str) -> str:
    """Foreign text made fit for a message."""
    clean = "".join(c if c.isprintable() else "?" for c in text[:80])
    return f"{clean}..." if len(text) > 80 else clean


class Connection:
    """A TCP connection that was started and may come up later. Close it, or use ``with``."""

    def __init__(self, host: str, address: str, port: int) -> None:
        self.port = port
        self.where = f"{host}:{port}"
        self._refusal: str | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        code = self._socket.connect_ex((address, port))
        if code not in (0, *_UNDER_WAY):
            self._refusal = os.strerror(code)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def refusal(self, deadline: float) -> str:
        """Why there is no connection by ``deadline``; empty if there is one."""
        if self._refusal is None:
            if not self._wait(selectors.EVENT_WRITE, deadline):
                return "no answer in time"
            code = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            self._refusal = os.strerror(code) if code else ""
        return self._refusal

    def receive(self, deadline: float) -> bytes | None:
        """Some bytes; empty when the other side closed; None when nothing came by ``deadline``. Raises ``OSError``."""
        if time.monotonic() >= deadline or not self._wait(selectors.EVENT_READ, deadline):
            return None
        return self._socket.recv(_MOST_AT_ONCE)

    def send(self, data: bytes, deadline: float) -> None:
        """Send a short text. Raises ``OSError``."""
        self._socket.settimeout(max(left(deadline), 1e-3))
        try:
            self._socket.sendall(data)
        finally:
            self._socket.setblocking(False)

    def _wait(self, event: int, deadline: float) -> bool:
        with selectors.DefaultSelector() as selector:
            selector.register(self._socket, event)
            return bool(selector.select(left(deadline)))


class Dashboard:
    """The dashboard on a connection: a line asked, a line answered, each of bounded length, all by one deadline.

    Raises
    ------
    LinkLost
        If what is there does not greet as a UR dashboard does; also from the methods when it falls silent.
    """

    def __init__(self, link: Connection, deadline: float) -> None:
        self._link, self._deadline = link, deadline
        self._held = bytearray()
        refusal = link.refusal(deadline)
        if refusal:
            raise LinkLost(
                f"{link.where}: no connection to the UR dashboard ({refusal}); is the controller switched on, is this"
                " its address, and does the network between allow it?"
            )
        self.greeting = self._read("its greeting")
        if "universal robots dashboard" not in self.greeting.lower():
            raise LinkLost(
                f"{link.where}: what answers is no UR dashboard: it greets with '{shown(self.greeting)}';"
                " check the address"
            )

    def ask(self, line: str) -> str:
        """The answer to one line."""
        try:
            self._link.send(f"{line}\n".encode("ascii"), self._deadline)
        except OSError as error:
            raise self._lost(f"the link broke while '{line}' was sent ({error})") from error
        return self._read(f"the answer to '{line}'")

    def _read(self, what: str) -> str:
        """The next line that is not empty."""
        while True:
            end = self._held.find(b"\n", 0, _LONGEST_LINE)
            if end >= 0:
                line = self._held[:end].decode("utf-8", errors="replace").strip()
                del self._held[: end + 1]
                if line:
                    return line
                continue
            if len(self._held) >= _LONGEST_LINE:
                raise self._lost(f"{what} is longer than {_LONGEST_LINE} bytes; this is no UR dashboard")
            try:
                more = self._link.receive(self._deadline)
            except OSError as error:
                raise self._lost(f"the link broke while waiting for {what} ({error})") from error
            if more is None:
                raise self._lost(f"connected, but {what} did not come in time")
            if not more:
                raise self._lost(f"the controller closed the connection before {what} came")
            self._held += more

    def _lost(self, what: str) -> LinkLost:
        return LinkLost(f"{self._link.where}: {what}; check the address; if it is right, restart the controller")


def stop_program(host: str, timeout_s: float, *, port: int = DASHBOARD_PORT) -> None:
    """Tell the controller, through a dashboard connection of its own, to stop its program: the arm brakes and rests.

    Raises
    ------
    LinkLost
        If it could not be told within ``timeout_s``, or did not obey (an e-Series arm in local control).
    """
    deadline = time.monotonic() + timeout_s
    with Connection(host, resolve(host, deadline), port) as link:
        dashboard = Dashboard(link, deadline)
        answer = dashboard.ask("stop")
        # a controller without a program answers with a failure, and that is as good
        if answer.startswith("Stopped") or dashboard.ask("running").lower().endswith("false"):
            return
    raise LinkLost(f"{host}: the controller did not stop its program: it answered '{shown(answer)}'")
