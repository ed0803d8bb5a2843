"""Opening, reading and closing of the port of a tracker bridge, for every kind of port that pyserial makes of a URL."""

from __future__ import annotations

import contextlib
import socket
import threading

import serial
from serial.urlhandler.protocol_socket import Serial as TcpPort

READ_TIMEOUT_S = 0.05
_READ_BYTES = 4096


class LinkFault(Exception):
    """The link failed or delivered damaged data; the bridge may or may not have executed the command."""


class Unreachable(LinkFault):
    """The link could not be opened: refused, unknown address, or not in time."""


class PortOpener:
    """Opens a port in a separate thread."""

    def __init__(self, url: str, baud: int, write_timeout_s: float) -> None:
        self._url, self._baud, self._write_timeout_s = url, baud, write_timeout_s
        self._port: serial.SerialBase | None = None
        self._error = ""
        self._done = threading.Event()
        self._abandoned = False
        self._lock = threading.Lock()
        threading.Thread(target=self._run, name="opening the tracker bridge", daemon=True).start()

    def _run(self) -> None:
        try:
            port = serial.serial_for_url(
                self._url, baudrate=self._baud, timeout=READ_TIMEOUT_S, write_timeout=self._write_timeout_s
            )
        except (serial.SerialException, OSError, ValueError) as error:
            self._error = str(error)
        else:
            with self._lock:
                if not self._abandoned:
                    self._port = port
            if self._abandoned:
                shut_down(port)
        self._done.set()

    def wait(self, timeout_s: float) -> serial.SerialBase:
        """Return the open port. Raises ``Unreachable`` if it fails or takes longer than ``timeout_s``."""
        self._done.wait(timeout_s)
        with self._lock:
            self._abandoned = self._port is None
        if self._port is None:
            raise Unreachable(self._error or f"could not be opened within {timeout_s:g} s")
        return self._port


def waiting(port: serial.SerialBase) -> bytes:
    """Return the pending bytes, at most ``_READ_BYTES``, without waiting. Raises as the port's methods."""
    number = min(port.in_waiting, _READ_BYTES)
    if not number:
        return b""
    if isinstance(port, TcpPort):  # in_waiting is only 0 or 1 here: reading byte by byte would take long
        return bytes(port._socket.recv(_READ_BYTES))
    return bytes(port.read(number))


def shut_down(port: serial.SerialBase) -> None:
    if isinstance(port, TcpPort):  # its close() waits, and leaks the socket of a broken link
        inner, port.is_open = port._socket, False
        with contextlib.suppress(OSError):
            inner.shutdown(socket.SHUT_RDWR)
        inner.close()
        return
    with contextlib.suppress(serial.SerialException, OSError):
        port.close()
