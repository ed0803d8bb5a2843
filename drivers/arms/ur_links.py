"""Plain TCP connections to a UR controller; a ``Patience`` limits every wait. IPv4 only."""

from __future__ import annotations

import errno
import ipaddress
import os
import queue
import re
import selectors
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Self

from drivers.arms.protocol import LinkLost
from drivers.patience import Patience, patient_get

DASHBOARD_PORT = 29999
PRIMARY_PORT = 30001
SCRIPT_PORT = 30003
RTDE_PORT = 30004

LOCAL_CONTROL = "the pendant is in local control"
_OWN_PREFIX = "rtde_control_cellapp_"
"""Begin of the names of this driver's control programs: the RTDE client's own name, then ours."""
_OWN_PROGRAM = re.compile(rf"{_OWN_PREFIX}(.+?)__(.+?)(?:\.urp)?$")
_LONGEST_PART = 24

_MAX_LINE = 4096
_READ_BYTES = 65536
_IN_PROGRESS = (errno.EINPROGRESS, errno.EWOULDBLOCK)


def resolve(host: str, patience: Patience) -> str:
    """Return the IPv4 address of a host. A thread calls the system's resolver, which has no time limit.

    Raises
    ------
    LinkLost
        If no address is found in time.
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
        address = patient_get(answer, patience)
    except queue.Empty:
        address = None
    if address is None:
        raise LinkLost(
            f"{printable(host)}: no IPv4 host of that name was found; check the spelling, or give a numeric address"
        )
    return address


def program_name(user: str) -> str:
    """Return the name of the control program that this computer starts for ``user``: a job's run, for example."""
    parts = (re.sub("[^A-Za-z0-9]+", "_", part).strip("_")[:_LONGEST_PART] for part in (socket.gethostname(), user))
    return _OWN_PREFIX + "__".join(part.strip("_") or "unnamed" for part in parts)


def other_user(program: str) -> str:
    """Return who started a program, from its name; empty if it is none of this driver's."""
    found = _OWN_PROGRAM.match(program)
    return "" if found is None else f"another cellapp, on {found.group(1)}, run {found.group(2)}"


def running_program(host: str, timeout_s: float) -> str:
    """Return the name of the program that runs or is paused; empty if none does, or the dashboard did not answer."""
    patience = Patience(timeout_s)
    try:
        with Connection.to(host, DASHBOARD_PORT, patience) as link:
            state, _, name = Dashboard(link, patience).ask("programState").partition(" ")
    except LinkLost:
        return ""
    return name if state in ("PLAYING", "PAUSED") else ""


def printable(text: str, longest: int = 80) -> str:
    """Return received text shortened and without control characters, for a message."""
    clean = "".join(c if c.isprintable() else "?" for c in text[:longest])
    return f"{clean}..." if len(text) > longest else clean


def cause(error: LinkLost) -> str:
    """Return the cause of a link error without the remedy, which the arm's message adds at its end."""
    return str(error).split("; ")[0]


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
    def to(cls, host: str, port: int, patience: Patience) -> Self:
        """Start a connection to a host by name or address. Raises ``LinkLost`` if there is no such host."""
        return cls(host, resolve(host, patience), port)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; harmless when closed."""
        self._socket.close()

    def shut_down(self) -> None:
        """Shut the connection down, so that a thread waiting for bytes gets the end; harmless when closed."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def keep_alive(self) -> None:
        """Enable TCP keep-alive: the system notices within seconds that the peer or the cable is gone."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in (("TCP_KEEPIDLE", 1), ("TCP_KEEPINTVL", 1), ("TCP_KEEPCNT", 2)):
            if hasattr(socket, option):
                self._socket.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)

    def refusal(self, patience: Patience) -> str:
        """Return why no connection was made in time; empty if connected."""
        if self._refusal is None:
            if not self._wait(selectors.EVENT_WRITE, patience):
                return "no answer in time"
            code = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            self._refusal = os.strerror(code) if code else ""
        return self._refusal

    def receive(self, patience: Patience) -> bytes | None:
        """Return some bytes; empty if the peer closed, None if nothing came in time. Raises ``OSError``."""
        if patience.over or not self._wait(selectors.EVENT_READ, patience):
            return None
        return self._socket.recv(_READ_BYTES)

    def send(self, data: bytes, patience: Patience) -> None:
        """Send a short text. Raises ``OSError``."""
        self._socket.settimeout(max(patience.remaining_s, 1e-3))
        try:
            self._socket.sendall(data)
        finally:
            self._socket.setblocking(False)

    def send_at_once(self, data: bytes) -> None:
        """Send a short text without waiting. Raises ``OSError``, also if the peer has not read earlier text."""
        if self._socket.send(data) != len(data):
            raise BrokenPipeError("the peer does not read")

    def _wait(self, event: int, patience: Patience) -> bool:
        with selectors.DefaultSelector() as selector:
            selector.register(self._socket, event)
            while not (ready := bool(selector.select(wait_s := patience.slice_s))) and wait_s > 0.0:
                pass
        return ready


class Dashboard:
    """Client of a dashboard server: one line per request and answer, of limited length.

    Attributes
    ----------
    patience : Patience
        Common time limit of all waits.

    Raises
    ------
    LinkLost
        If the peer's greeting is not that of a UR dashboard; also from the methods if it stops answering.
    """

    def __init__(self, link: Connection, patience: Patience) -> None:
        self._link, self.patience = link, patience
        self._received = bytearray()
        refusal = link.refusal(patience)
        if refusal:
            raise LinkLost(
                f"{link.where}: no connection to the UR dashboard ({refusal}); is the controller switched on, is this"
                " its address, and does the network between allow it?"
            )
        greeting = self._read("its greeting")
        if "universal robots dashboard" not in greeting.lower():
            raise LinkLost(
                f"{link.where}: the peer is not a UR dashboard: its greeting is '{printable(greeting)}';"
                " check the address"
            )

    def ask(self, line: str) -> str:
        """Send one line and return the answer."""
        try:
            self._link.send(f"{line}\n".encode("ascii"), self.patience)
        except OSError as error:
            raise self._lost(f"the link broke while '{line}' was sent ({error})") from error
        return self._read(f"the answer to '{line}'")

    def _read(self, what: str) -> str:
        """Return the next non-empty line; ``what`` names it in messages."""
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
                more = self._link.receive(self.patience)
            except OSError as error:
                raise self._lost(f"the link broke while waiting for {what} ({error})") from error
            if more is None:
                raise self._lost(f"connected, but {what} did not come in time")
            if not more:
                raise self._lost(f"the controller closed the connection before {what} came")
            self._received += more

    def _lost(self, what: str) -> LinkLost:
        return LinkLost(f"{self._link.where}: {what}; check the address; if it is right, restart the controller")


def stop_program(
    host: str, timeout_s: float, *, port: int = DASHBOARD_PORT, look: Callable[[], None] | None = None
) -> None:
    """Stop the controller's program over a separate dashboard connection: the arm brakes and rests.

    ``look`` is called while this waits and may raise.

    Raises
    ------
    LinkLost
        If it could not be reached within ``timeout_s``, or did not stop; the message says if it is in local control.
    """
    patience = Patience(timeout_s, look=look)
    with Connection.to(host, port, patience) as link:
        require_stopped(Dashboard(link, patience).ask, host)


def require_stopped(ask: Callable[[str], str], host: str) -> None:
    """Stop the program with dashboard commands through ``ask``. Raises ``LinkLost`` as ``stop_program`` does."""
    answer = ask("stop")
    # a controller without a running program reports a failure, but it is stopped
    if answer.startswith("Stopped") or ask("running").lower().endswith("false"):
        return
    why = f"it answered '{printable(answer)}'"
    if ask("is in remote control").lower() == "false":
        why = f"{LOCAL_CONTROL}, in which it takes no stop over the network"
    raise LinkLost(f"{host}: the controller did not stop its program: {why}")


def in_local_control(host: str, timeout_s: float) -> bool:
    """Return whether the pendant is in local control; False if the controller has no such switch or did not answer."""
    patience = Patience(timeout_s)
    try:
        with Connection.to(host, DASHBOARD_PORT, patience) as link:
            return Dashboard(link, patience).ask("is in remote control").lower() == "false"
    except LinkLost:
        return False
