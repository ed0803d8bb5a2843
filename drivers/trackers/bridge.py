"""A tracker behind a bridge: on a serial cable, a serial server or TCP, whatever URL pyserial knows. See BRIDGE.md.

After any doubt (a damaged line, silence, a link that broke) the link is synchronised anew, and a measurement is asked
for again under the id that it had: the bridge then returns the one that it made; none is lost and none is made twice.
"""

from __future__ import annotations

import contextlib
import logging
import secrets
import socket
import threading
import time
from collections.abc import Callable, Mapping
from typing import NoReturn, TypeVar

import numpy as np
import serial
from numpy.typing import NDArray
from serial.urlhandler.protocol_socket import Serial as TcpPort

from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge_wire import BadField, Fields, Garbled, Line
from drivers.trackers.protocol import (
    Halted,
    Inclination,
    NotReady,
    Point,
    Preparation,
    TrackerError,
    TrackerIdentity,
    TrackerLinkLost,
    TrackerRefused,
    TwoFace,
)

LOG = logging.getLogger(__name__)

_T = TypeVar("_T")

_SLICE_S = 0.05
_RETRY_S = 0.2
_AT_ONCE = 4096
_MOST_STALE_LINES = 500
_MOST_DRAINED = 1_000_000
_LONGEST_COMMAND_S = 600.0
_HALTED = ("prepare", "measure", "two-face")
"""Commands that ``halt`` ends."""


class _Doubt(Exception):
    """Something on the link was not as it must be; what was asked may or may not have been done."""


class _Busy(Exception):
    """The tracker is at work on what was asked before."""


class _Unprepared(Exception):
    """The bridge wants the tracker prepared by this client first."""


class BridgeTracker:
    """A tracker behind a bridge. Calls come from one thread, ``halt`` from any."""

    def __init__(
        self,
        url: str,
        *,
        token: str | None = None,
        timeout_s: float = 5.0,
        baud: int = 115200,
        preparation: Preparation | None = None,
        patience_s: float | None = None,
    ) -> None:
        """Prepare to speak with the bridge at ``url`` (``socket://host:port``, ``rfc2217://host:port``, ``COM3``, ...).

        ``timeout_s`` is how long the bridge may be silent; while it works it says so every second. ``preparation`` is
        applied at every connect; without one it is left to ``prepare``. ``patience_s`` is how long a command may take
        in all, by default as long as the bridge itself gives the tracker. Nothing is opened yet.
        """
        self._url = url
        self._token = token
        self._timeout_s = timeout_s
        self._baud = baud
        self._settings = preparation
        self._patience_s = patience_s
        self._client = secrets.token_hex(8)
        self._port: serial.SerialBase | None = None
        self._held = bytearray()
        self._sequence = secrets.randbelow(wire.LAST_SEQUENCE)
        self._in_doubt = False
        self._boot = ""
        self._longest_s = 60.0
        self._writing = threading.Lock()
        self._halting = threading.Event()
        self._pause = threading.Event()  # never set

    # -- the tracker's calls -------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Open the link, introduce this client, have the tracker prepared; tried once.

        Raises ``TrackerLinkLost`` where nobody answers, ``TrackerRefused`` where another client holds the tracker or
        the token is wrong, ``NotReady`` where it cannot be prepared as asked.
        """
        self._close()
        self._halting.clear()
        try:
            self._establish(time.monotonic() + 2.0 * self._timeout_s)
            if self._settings is not None:
                self.prepare(self._settings)
        except _Doubt as error:
            self._lost(error)
        except ValueError as error:
            self._close()
            raise NotReady(f"{error}; change it in the profile") from error
        except TrackerError:
            self._close()
            raise

    def identify(self) -> TrackerIdentity:
        """Ask the tracker who it is."""
        return self._read(wire.read_identity, self._ask("identify"))

    def prepare(self, settings: Preparation) -> None:
        """Have the tracker initialised where needed and set up; from now on also after every connect."""
        self._halting.clear()
        self._ask("prepare", wire.preparation_fields(settings) | {"id": _new_id()})
        self._settings = settings

    def unmet(self) -> list[str]:
        """Every precondition that keeps the tracker from measuring, in words."""
        return self._read(wire.read_unmet, self._ask("unmet"))

    def measure(self, expected_M: NDArray[np.float64], averaging_s: float) -> Point:
        """Have the SMR at ``expected_M`` (3,) [m] measured. Raises as every tracker does."""
        self._halting.clear()
        return self._read(wire.read_point, self._ask("measure", _wanted(expected_M, averaging_s)))

    def measure_two_face(self, expected_M: NDArray[np.float64], averaging_s: float) -> TwoFace:
        """Have the SMR at ``expected_M`` (3,) [m] measured in both faces. Raises as every tracker does."""
        self._halting.clear()
        return self._read(wire.read_two_face, self._ask("two-face", _wanted(expected_M, averaging_s)))

    def inclination(self) -> Inclination | None:
        """The level, or None where there is none."""
        return self._read(wire.read_inclination, self._ask("inclination"))

    def halt(self) -> None:
        """End what is under way, which then raises ``Halted``; from any thread, and harmless when nothing is."""
        self._halting.set()
        with contextlib.suppress(_Doubt):  # whoever waits for an answer finds the link broken, and halts after it
            self._write(wire.encode(self._next_sequence(), "halt"))

    def disconnect(self) -> None:
        """Let the tracker go and close the link; harmless when closed."""
        if self._port is not None and not self._in_doubt:
            with contextlib.suppress(_Doubt, _Busy, TrackerError):  # the bridge also lets go of who is silent
                self._exchange("bye", {}, time.monotonic() + min(self._timeout_s, 1.0))
        self._close()

    # -- asking, again where there is doubt ----------------------------------------------------------------------------

    def _ask(self, verb: str, fields: Mapping[str, str] | None = None) -> Fields:
        """The answer to a command, which may be given more than once: it has an id, or changes nothing."""
        if self._port is None and not self._in_doubt:
            raise TrackerLinkLost(f"tracker bridge {self._url}: not open; connect first")
        patience_s = self._longest_s + 2.0 * self._timeout_s if self._patience_s is None else self._patience_s
        until_s = time.monotonic() + patience_s
        problem: Exception = _Doubt("no answer")
        while time.monotonic() < until_s:
            try:
                if self._port is None or self._in_doubt:
                    self._recover(until_s)
                if self._halting.is_set() and verb in _HALTED:
                    self._exchange("halt", {}, until_s)
                    raise Halted(f"tracker bridge {self._url}: halted; the measurement, if any, was given up")
                return self._exchange(verb, fields or {}, until_s)
            except _Unprepared as error:
                self._prepare_again(error, until_s)
            except _Busy as error:
                problem = error
            except _Doubt as error:
                LOG.info("tracker bridge %s: %s; synchronising", self._url, error)
                problem = error
                self._in_doubt = True
            self._pause.wait(_RETRY_S)
        self._lost(problem)

    def _lost(self, problem: Exception) -> NoReturn:
        self._close()
        raise TrackerLinkLost(
            f"tracker bridge {self._url}: {problem}; see that the tracker's computer runs 'cellapp tracker-bridge' and"
            " that cable, address and port are right"
        ) from problem

    def _read(self, reader: Callable[[Fields], _T], fields: Fields) -> _T:
        """What an answer says. Raises ``TrackerError`` where it is whole but makes no sense."""
        try:
            return reader(fields)
        except BadField as error:
            raise TrackerError(f"tracker bridge {self._url}: the bridge's answer makes no sense: {error}") from error

    def _recover(self, until_s: float) -> None:
        """Make the link trustworthy again. Raises ``_Doubt``."""
        if self._port is None:
            self._establish(until_s)
            return
        try:
            answer = self._synchronise(until_s)
            if answer.get("boot") == self._boot and answer.get("holding") == "1":
                self._in_doubt = False
            else:
                self._introduce(until_s)
        except _Doubt:
            self._close_port()
            raise

    def _prepare_again(self, problem: Exception, until_s: float) -> None:
        """The bridge has started anew, or another client had the tracker: set it up as it was."""
        if self._settings is None:
            raise NotReady(f"tracker bridge {self._url}: {problem}") from problem
        try:
            self._exchange("prepare", wire.preparation_fields(self._settings) | {"id": _new_id()}, until_s)
        except (_Doubt, _Busy) as error:
            self._in_doubt = self._in_doubt or isinstance(error, _Doubt)
            self._pause.wait(_RETRY_S)

    def _establish(self, until_s: float) -> None:
        """Open the port, synchronise, introduce this client. Raises ``_Doubt``, or ``TrackerRefused``."""
        self._open()
        self._synchronise(until_s)
        self._introduce(until_s)

    def _introduce(self, until_s: float) -> None:
        hello = {"protocol": str(wire.VERSION), "client": self._client}
        answer = self._exchange("hello", hello, until_s)
        try:
            longest_s = wire.read_number(answer, "longest", 0.0, 1e6)
        except BadField as error:
            raise _Doubt(f"the bridge introduced itself badly: {error}") from error
        if answer.get("auth") == "hmac-sha256":
            self._prove(answer.get("nonce", ""), until_s)
        elif self._token is not None:
            self._close()
            raise TrackerRefused(
                f"tracker bridge {self._url}: a token is set here, but the bridge asks for none: it is not the one that"
                " was meant, or was started without its token"
            )
        self._boot = answer.get("boot", "")
        self._longest_s = min(longest_s, _LONGEST_COMMAND_S)
        self._in_doubt = False

    def _prove(self, nonce: str, until_s: float) -> None:
        """Show that the token is known, without showing it, and have the bridge show the same."""
        if self._token is None:
            self._close()
            raise TrackerRefused(f"tracker bridge {self._url}: it asks for a token; name it in the profile")
        ours = secrets.token_hex(16)
        known = wire.proof(self._token, "client", self._client, nonce, ours)
        answer = self._exchange("auth", {"nonce": ours, "proof": known}, until_s)
        if not wire.same(answer.get("proof", ""), wire.proof(self._token, "server", self._client, nonce, ours)):
            self._close()
            raise TrackerRefused(f"tracker bridge {self._url}: it does not know the token; it is not the real bridge")

    def _synchronise(self, until_s: float) -> Fields:
        """Read away whatever comes until the answer to a number that nobody can know. Raises ``_Doubt``."""
        nonce = secrets.token_hex(8)
        self._held.clear()
        sequence = self._next_sequence()
        until_s = min(until_s, time.monotonic() + self._timeout_s)
        self._write(b"\n" + wire.encode(sequence, "sync", {"nonce": nonce}))
        drained = 0
        while drained < _MOST_DRAINED:
            raw = self._raw_line(until_s)
            drained += len(raw)
            with contextlib.suppress(Garbled):
                line = wire.decode(raw)
                if line.sequence == sequence and line.word == "ok" and line.fields.get("nonce") == nonce:
                    return line.fields
        raise _Doubt("what comes over the link is no bridge's")

    def _exchange(self, verb: str, fields: Fields, until_s: float) -> Fields:
        """One command and its answer. Raises ``_Doubt``, ``_Busy``, or what the tracker said."""
        sequence = self._next_sequence()
        try:
            line = wire.encode(sequence, verb, fields)
        except ValueError as error:
            raise NotReady(f"tracker bridge {self._url}: {error}") from error
        self._write(line)
        for _ in range(_MOST_STALE_LINES):
            raw = self._raw_line(min(until_s, time.monotonic() + self._timeout_s))
            try:
                answer = wire.decode(raw)
            except Garbled as error:
                raise _Doubt(f"a damaged line came ({error})") from error
            if answer.sequence == 0 and answer.word == "error":
                raise _Doubt(answer.fields.get("text", "the bridge did not understand"))
            if answer.sequence != sequence:
                continue  # an answer to what was given up before
            if answer.word == "wait":  # a sign of life
                if self._halting.is_set() and verb in _HALTED:
                    self._write(wire.encode(self._next_sequence(), "halt"))
                continue
            if answer.word == "ok":
                return answer.fields
            self._said(verb, answer)
        raise _Doubt("the answer does not come for all that is said")

    def _said(self, verb: str, answer: Line) -> NoReturn:
        """Raise what an ``error`` means."""
        kind, words = answer.fields.get("kind", ""), answer.fields.get("text", "no reason was given")
        if kind == "busy":
            raise _Busy(words)
        if kind == "unprepared":
            raise _Unprepared(words)
        if kind in ("no-session", "garbled"):
            raise _Doubt(words)
        if kind in ("held", "refused", "version"):
            self._close()
        if kind in ("bad-field", "unknown-command"):
            raise ValueError(f"tracker bridge {self._url}: '{verb}' was refused: {words}")
        raise wire.ERRORS.get(kind, TrackerError)(words)

    # -- bytes ---------------------------------------------------------------------------------------------------------

    def _next_sequence(self) -> int:
        with self._writing:
            self._sequence = self._sequence % wire.LAST_SEQUENCE + 1
            return self._sequence

    def _open(self) -> None:
        """Open the port. Raises ``_Doubt``.

        In a thread of its own, because looking up a name, and what some kinds of port do when opened, know no time
        limit; a port that opens too late is closed at once.
        """
        self._close_port()
        opening = _Opening(self._url, self._baud, write_timeout_s=self._timeout_s)
        self._port = opening.wait(self._timeout_s)
        self._held.clear()

    def _write(self, data: bytes) -> None:
        with self._writing:
            if self._port is None:
                raise _Doubt("the link is closed")
            try:
                self._port.write(data)
            except (serial.SerialException, OSError) as error:
                raise _Doubt(f"the link broke: {error}") from error

    def _raw_line(self, until_s: float) -> bytes:
        """The next line, with its end. Raises ``_Doubt`` when none comes in time or it is too long."""
        while True:
            end = self._held.find(b"\n") + 1
            if end:
                raw = bytes(self._held[:end])
                del self._held[:end]
                return raw
            if len(self._held) > wire.LONGEST_LINE:
                raise _Doubt(f"a line longer than {wire.LONGEST_LINE} bytes came")
            if time.monotonic() > until_s:
                raise _Doubt(f"no answer within {self._timeout_s:g} s")
            port = self._port
            if port is None:
                raise _Doubt("the link is closed")
            try:
                self._held += port.read(1)
                waiting = port.in_waiting
                if waiting:
                    self._held += port.read(min(waiting, _AT_ONCE))
            except (serial.SerialException, OSError) as error:
                if b"\n" in self._held:
                    continue  # the last words of who hung up then
                raise _Doubt(f"the link broke: {error}") from error

    def _close(self) -> None:
        self._close_port()
        self._in_doubt = False

    def _close_port(self) -> None:
        with self._writing:
            port, self._port = self._port, None
        if port is not None:
            _shut(port)


class _Opening:
    """A port that is being opened in a thread of its own."""

    def __init__(self, url: str, baud: int, write_timeout_s: float) -> None:
        self._url, self._baud, self._write_timeout_s = url, baud, write_timeout_s
        self._port: serial.SerialBase | None = None
        self._why = ""
        self._done = threading.Event()
        self._given_up = False
        self._lock = threading.Lock()
        threading.Thread(target=self._run, name="opening the tracker bridge", daemon=True).start()

    def _run(self) -> None:
        try:
            port = serial.serial_for_url(
                self._url, baudrate=self._baud, timeout=_SLICE_S, write_timeout=self._write_timeout_s
            )
        except (serial.SerialException, OSError, ValueError) as error:
            self._why = str(error)
        else:
            with self._lock:
                if not self._given_up:
                    self._port = port
            if self._given_up:
                _shut(port)
        self._done.set()

    def wait(self, timeout_s: float) -> serial.SerialBase:
        """The open port. Raises ``_Doubt``."""
        self._done.wait(timeout_s)
        with self._lock:
            self._given_up = self._port is None
        if self._port is None:
            raise _Doubt(self._why or f"could not be opened within {timeout_s:g} s")
        return self._port


def _shut(port: serial.SerialBase) -> None:
    if isinstance(port, TcpPort):  # its own close waits, and leaves the socket of a broken link to the collector
        inner, port.is_open = port._socket, False
        with contextlib.suppress(OSError):
            inner.shutdown(socket.SHUT_RDWR)
        inner.close()
        return
    with contextlib.suppress(serial.SerialException, OSError):
        port.close()


def _new_id() -> str:
    return secrets.token_hex(8)


def _wanted(expected_M: NDArray[np.float64], averaging_s: float) -> dict[str, str]:
    """The fields of a measurement under a new id. Raises ``ValueError`` for what is no point or no time."""
    expected = np.asarray(expected_M, dtype=np.float64)
    if expected.shape != (3,) or not np.isfinite(expected).all():
        raise ValueError("tracker: the expected point must be three finite coordinates in metres")
    if not 0.0 < averaging_s <= _LONGEST_COMMAND_S:
        raise ValueError(f"tracker: averaging must last longer than 0 s, not {averaging_s!r} s")
    x, y, z = (wire.number(value) for value in expected)
    return {"id": _new_id(), "x": x, "y": y, "z": z, "averaging": wire.number(averaging_s)}
