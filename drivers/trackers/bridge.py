"""Client of the tracker bridge, over any pyserial URL (serial port, serial server, TCP). BRIDGE.md has the protocol.

After any fault of the link (a damaged line, silence, a broken connection) the client synchronises again and repeats the
command under the same id. The bridge then returns the result that it has stored: no measurement is lost, none is made
twice.
"""

from __future__ import annotations

import contextlib
import logging
import math
import secrets
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NoReturn, TypeVar

import numpy as np
import serial
from numpy.typing import NDArray
from serial.urlhandler.protocol_socket import Serial as TcpPort

from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge_wire import BadField, Fields, Garbled, WireLine, read_limits, read_packet
from drivers.trackers.protocol import (
    Halted,
    NotReady,
    Point,
    Preparation,
    StreamLimits,
    Track,
    TrackerError,
    TrackerIdentity,
    TrackerLinkLost,
    TrackerRefused,
    TrackerTimeout,
    checked_point,
    no_packet,
)

# ---------------------------------------------------------------------------------------------------------------------
# Opening, reading and closing of the port of a tracker bridge, for every kind of port that pyserial makes of a URL.


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


LOG = logging.getLogger(__name__)

_T = TypeVar("_T")

_FIRST_RETRY_S = 0.02
_RETRY_S = 0.2
"""Longest pause between two attempts. The first is short, as most faults are over at once; each next one doubles."""
_MAX_STALE_LINES = 500
_MAX_DRAINED_BYTES = 1_000_000
_LONGEST_COMMAND_S = 600.0
_SILENT_SHARE = 0.9
"""Silence counts only if this process looked for a line for this share of the time: it may not have been scheduled."""
_CONFIRMING_TRIES = 3
"""Attempts of ``confirm``: after a damaged line or an ended connection it reconnects and asks again."""
_HALTABLE = ("prepare", "measure", "track")
"""Commands that ``halt`` can end."""
_FROM_TRACKER = ("identify", "prepare", "unmet", "confirm", "measure", "track", "end-track")
"""Commands that the tracker itself answers, and not the bridge."""


class _Silent(LinkFault):
    """No line arrived in time, although this process looked for one."""


class _Busy(Exception):
    """The tracker is still executing an earlier command."""


class UnknownCommand(ValueError):
    """The bridge is older than this client."""


class _NotPrepared(Exception):
    """The bridge requires that this client prepares the tracker first."""


_SILENT_S = 1.0
"""A track is dead if no point arrives for this long and for ten point intervals."""
_AT_ONCE_S = 0.15
"""Longest time of fetching points in one go, as other commands may be waiting."""
_REST_WITHIN_S = 60.0
"""Time limit for fetching the remaining points of a finished track, over a slow line."""


@dataclass
class _Running:
    """The client's state of a track."""

    id: str
    interval_s: float
    lost: Callable[[TrackerError], None]
    received: Callable[[Track], None]
    next: int = 0
    on: bool = True
    heard_s: float = field(default_factory=time.monotonic)
    packets: list[Track] = field(default_factory=list)

    @property
    def wanted(self) -> dict[str, str]:
        """Fields of the request for the next points."""
        return {"track": self.id, "from": str(self.next)}


class BridgeTracker:
    """A tracker behind a bridge, which reports whether it can stream.

    Calls come one at a time; ``halt`` and ``data_age_s`` may be called at any time.
    """

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
        """Configure a client of the bridge at ``url`` (``socket://host:port``, ``rfc2217://host:port``, ``COM3``, ...).

        ``timeout_s`` is the longest silence of the bridge, which sends a line every 0.2 s while it executes a command.
        ``preparation`` is applied at every connect; without one, call ``prepare``. ``patience_s`` limits the total time
        of a command; None: the limit of the bridge itself. Nothing is opened yet.
        """
        self._url = url
        self._token = token
        self._timeout_s = timeout_s
        self._baud = baud
        self._settings = preparation
        self._patience_s = patience_s
        self._client = secrets.token_hex(8)
        self._port: serial.SerialBase | None = None
        self._received = bytearray()
        self._sequence = secrets.randbelow(wire.LAST_SEQUENCE)
        self._out_of_sync = False
        self._boot = ""
        self._confirms = True
        """Whether the bridge knows the command ``confirm``."""
        self._sign_s = -math.inf
        """Time of the tracker's last sign of life on the monotonic clock [s]."""
        self._limits: StreamLimits | None = None
        self._asked = False
        """Whether the bridge was asked for its stream limits since ``connect``."""
        self._track: _Running | None = None
        self._longest_s = 60.0
        self._writing = threading.Lock()
        self._halting = threading.Event()
        self._pause = threading.Event()  # never set

    # -- the tracker's calls -------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Open the link and a session, and prepare the tracker; one attempt.

        Raises ``TrackerLinkLost`` if the bridge does not answer, ``TrackerRefused`` if another client holds the tracker
        or the token is wrong, ``NotReady`` if the tracker cannot be prepared as configured.
        """
        self._close()
        self._halting.clear()
        self._limits, self._asked, self._track = None, False, None
        try:
            self._establish(time.monotonic() + 2.0 * self._timeout_s)
            if self._settings is not None:
                self.prepare(self._settings)
        except LinkFault as error:
            self._raise_link_lost(error)
        except ValueError as error:
            self._close()
            raise NotReady(f"{error}; change it in the profile") from error
        except TrackerError:
            self._close()
            raise

    def identify(self) -> TrackerIdentity:
        """Return model, serial number and software of the tracker."""
        return self._read(wire.read_identity, self._command("identify"))

    def prepare(self, settings: Preparation) -> None:
        """Initialise the tracker where needed and apply ``settings``, now and after every connect."""
        self._halting.clear()
        self._command("prepare", wire.preparation_fields(settings) | {"id": wire.new_id()})
        self._settings = settings

    def unmet(self) -> list[str]:
        """Return every unmet precondition of measuring, as sentences."""
        return self._read(wire.read_unmet, self._command("unmet"))

    def confirm(self, within_s: float) -> None:
        """Check that the tracker behind the bridge answers now. Raises as the protocol says.

        The bridge does not answer for the tracker. An old bridge without this command is asked ``unmet`` instead.
        """
        self._require_open()
        until_s = time.monotonic() + within_s
        problem: Exception = LinkFault("no answer")
        for _ in range(_CONFIRMING_TRIES):
            try:
                if self._port is None or self._out_of_sync:
                    self._recover(until_s)
                self._ask(within_s, until_s)
                return
            except UnknownCommand:
                self._confirms = False
            except _Busy as error:
                raise TrackerTimeout(f"tracker bridge {self._url}: {error}") from error
            except LinkFault as error:
                problem, self._out_of_sync = error, True
                if isinstance(error, Unreachable | _Silent):
                    break
        if isinstance(problem, _Silent):
            problem = LinkFault(f"no answer from the tracker within {within_s:g} s")
        raise self._link_lost(problem) from problem

    def _ask(self, within_s: float, until_s: float) -> None:
        """Ask the tracker once for a sign of life; during a track fetch its points, which are one."""
        track = self._track
        if track is not None and track.on:
            with _known(track):
                self._fetch(track, until_s, min(until_s, time.monotonic() + _AT_ONCE_S))
            silent_s = time.monotonic() - track.heard_s
            if track.on and silent_s > max(_SILENT_S, 10.0 * track.interval_s):
                raise TrackerLinkLost(
                    f"tracker bridge {self._url}: no point of the moving SMR came for {silent_s:.1f} s"
                )
        elif self._confirms:
            self._exchange("confirm", {"within": wire.number(within_s)}, until_s)
        else:
            self._exchange("unmet", {}, until_s)

    def data_age_s(self) -> float:
        """Return the time since the tracker's last sign of life [s]; inf before the first.

        A sign of life is an answer of the tracker, or the age of one that the bridge reports; not an answer of the
        bridge itself.
        """
        return time.monotonic() - self._sign_s

    def measure(self, expected_M: NDArray[np.float64], averaging_s: float) -> Point:
        """Measure the SMR at ``expected_M`` (3,) [m]. Raises the errors of ``Tracker.measure``."""
        self._halting.clear()
        return self._read(wire.read_point, self._command("measure", _smr_fields(expected_M, "averaging", averaging_s)))

    def halt(self) -> None:
        """End the running command, which then raises ``Halted``; harmless when none runs. From any thread."""
        self._halting.set()
        with contextlib.suppress(LinkFault):  # the waiting command detects the fault and halts after it
            self._write(wire.encode(self._next_sequence(), "halt"))

    def disconnect(self) -> None:
        """Release the tracker and close the link; harmless when closed."""
        if self._port is not None and not self._out_of_sync:
            with contextlib.suppress(LinkFault, _Busy, TrackerError):  # the bridge also releases a silent client
                self._exchange("bye", {}, time.monotonic() + min(self._timeout_s, 1.0))
        self._close()

    # -- a moving SMR: the bridge keeps its points until they are fetched: a link that breaks for a moment loses none --

    def stream_limits(self) -> StreamLimits | None:
        """Return what the tracker behind the bridge can stream; None also if the bridge does not know streams."""
        if not self._asked:
            with contextlib.suppress(UnknownCommand):
                self._limits = self._read(read_limits, self._command("stream-limits"))
            self._asked = True
        return self._limits

    def start_track(
        self,
        expected_M: NDArray[np.float64],
        interval_s: float,
        lost: Callable[[TrackerError], None],
        received: Callable[[Track], None] = no_packet,
    ) -> None:
        """Make the tracker lock and follow the SMR; ``confirm`` fetches its points."""
        limits = self.stream_limits()
        if limits is None:
            raise TrackerError(f"tracker bridge {self._url}: its tracker does not measure an SMR while it moves")
        limits.check(interval_s)
        fields = _smr_fields(expected_M, "interval", interval_s)
        self._halting.clear()
        self._command("track", fields)
        self._track = _Running(fields["id"], interval_s, lost, received)

    def end_track(self) -> Track:
        """End the track, fetch the buffered points and return all points."""
        track, self._track = self._track, None
        if track is None:
            return Track.of([])
        with _known(track):
            self._command("end-track", {"track": track.id})
            track.lost = _nobody
            until_s = time.monotonic() + _REST_WITHIN_S
            while self._take(track, self._command("points", track.wanted)):
                if time.monotonic() > until_s:
                    raise TrackerLinkLost(
                        f"tracker bridge {self._url}: its points did not come within {_REST_WITHIN_S:g} s"
                    )
        return Track.of(track.packets)

    def _fetch(self, track: _Running, until_s: float, enough_s: float) -> None:
        """Fetch buffered points, at least one answer, until ``enough_s``."""
        while True:
            if not self._take(track, self._exchange("points", track.wanted, until_s)) or time.monotonic() > enough_s:
                return

    def _take(self, track: _Running, answer: Fields) -> bool:
        """Store the points of an answer and call the listeners; return whether there may be more."""
        now_s = time.monotonic()
        packet, waiting = self._read(lambda fields: read_packet(fields, now_s), answer)
        track.next = int(
            self._read(lambda fields: wire.read_number(fields, "next", track.next, track.next + 1), answer)
        )
        if len(packet.device_time_s):
            track.heard_s = now_s
            self._sign_of_life({})
            track.packets.append(packet)
            track.received(packet)
        if kind := answer.get("lost.kind", ""):
            track.on = False
            track.lost(wire.ERRORS.get(kind, TrackerError)(answer.get("lost.text", "the track has ended")))
        return waiting > 0

    # -- commands, repeated after a link fault -------------------------------------------------------------------------

    def _command(self, verb: str, fields: Mapping[str, str] | None = None) -> Fields:
        """Return the answer to a command. It may be sent more than once, so it must have an id or change nothing."""
        self._require_open()
        patience_s = self._longest_s + 2.0 * self._timeout_s if self._patience_s is None else self._patience_s
        until_s = time.monotonic() + patience_s
        problem: Exception = LinkFault("no answer")
        pause_s = _FIRST_RETRY_S
        while time.monotonic() < until_s:
            try:
                if self._port is None or self._out_of_sync:
                    self._recover(until_s)
                if self._halting.is_set() and verb in _HALTABLE:
                    self._exchange("halt", {}, until_s)
                    raise Halted(f"tracker bridge {self._url}: halted; the measurement, if any, was abandoned")
                return self._exchange(verb, fields or {}, until_s)
            except _NotPrepared as error:
                self._prepare_again(error, until_s)
            except _Busy as error:
                problem = error
            except LinkFault as error:
                LOG.info("tracker bridge %s: %s; synchronising", self._url, error)
                problem = error
                self._out_of_sync = True
            self._pause.wait(pause_s)
            pause_s = min(2.0 * pause_s, _RETRY_S)
        self._raise_link_lost(problem)

    def _require_open(self) -> None:
        if self._port is None and not self._out_of_sync:
            raise TrackerLinkLost(f"tracker bridge {self._url}: not open; connect first")

    def _link_lost(self, problem: Exception) -> TrackerLinkLost:
        return TrackerLinkLost(
            f"tracker bridge {self._url}: {problem}; see that the tracker's computer runs"
            " 'cellapp tracker-bridge PROFILE' and that cable, address and port are right"
        )

    def _raise_link_lost(self, problem: Exception) -> NoReturn:
        self._close()
        raise self._link_lost(problem) from problem

    def _read(self, reader: Callable[[Fields], _T], fields: Fields) -> _T:
        """Convert an answer. Raises ``TrackerError`` if it is undamaged but invalid."""
        try:
            return reader(fields)
        except BadField as error:
            raise TrackerError(f"tracker bridge {self._url}: the bridge's answer is invalid: {error}") from error

    def _recover(self, until_s: float) -> None:
        """Synchronise the link, or reopen it. Raises ``LinkFault``."""
        if self._port is None:
            self._establish(until_s)
            return
        try:
            answer = self._synchronise(until_s)
            if answer.get("boot") == self._boot and answer.get("holding") == "1":
                self._out_of_sync = False
            else:
                self._open_session(until_s)
        except LinkFault:
            self._close_port()
            raise

    def _prepare_again(self, problem: Exception, until_s: float) -> None:
        """Prepare the tracker again, because the bridge restarted or another client held it."""
        if self._settings is None:
            raise NotReady(f"tracker bridge {self._url}: {problem}") from problem
        try:
            self._exchange("prepare", wire.preparation_fields(self._settings) | {"id": wire.new_id()}, until_s)
        except (LinkFault, _Busy) as error:
            self._out_of_sync = self._out_of_sync or isinstance(error, LinkFault)
            self._pause.wait(_RETRY_S)

    def _establish(self, until_s: float) -> None:
        """Open the port, synchronise, open a session. Raises ``LinkFault`` or ``TrackerRefused``."""
        self._open(until_s)
        self._synchronise(until_s)
        self._open_session(until_s)

    def _open_session(self, until_s: float) -> None:
        """Open a session. Raises ``LinkFault`` or ``TrackerRefused``."""
        hello = {"protocol": str(wire.VERSION), "client": self._client}
        answer = self._exchange("hello", hello, until_s)
        try:
            longest_s = wire.read_number(answer, "longest", 0.0, 1e6)
        except BadField as error:
            raise LinkFault(f"the bridge's answer to 'hello' is invalid: {error}") from error
        if answer.get("auth") == "hmac-sha256":
            self._prove(answer.get("nonce", ""), until_s)
        elif self._token is not None:
            self._close()
            raise TrackerRefused(
                f"tracker bridge {self._url}: a token is set here, but the bridge asks for none: it is another"
                " bridge, or was started without its token"
            )
        self._boot = answer.get("boot", "")
        self._longest_s = min(longest_s, _LONGEST_COMMAND_S)
        self._confirms = True
        self._out_of_sync = False

    def _prove(self, nonce: str, until_s: float) -> None:
        """Prove knowledge of the token without sending it; require the same of the bridge."""
        if self._token is None:
            self._close()
            raise TrackerRefused(f"tracker bridge {self._url}: it asks for a token; name it in the profile")
        ours = secrets.token_hex(16)
        known = wire.proof(self._token, "client", self._client, nonce, ours)
        answer = self._exchange("auth", {"nonce": ours, "proof": known}, until_s)
        if not wire.proofs_equal(answer.get("proof", ""), wire.proof(self._token, "server", self._client, nonce, ours)):
            self._close()
            raise TrackerRefused(f"tracker bridge {self._url}: it does not know the token; it is not the real bridge")

    def _synchronise(self, until_s: float) -> Fields:
        """Discard input up to the answer that repeats a random nonce. Raises ``LinkFault``."""
        nonce = secrets.token_hex(8)
        self._received.clear()
        sequence = self._next_sequence()
        until_s = min(until_s, time.monotonic() + self._timeout_s)
        self._write(b"\n" + wire.encode(sequence, "sync", {"nonce": nonce}))
        drained = 0
        while drained < _MAX_DRAINED_BYTES:
            raw = self._raw_line(until_s)
            drained += len(raw)
            with contextlib.suppress(Garbled):
                line = wire.decode(raw)
                if line.sequence == sequence and line.word == "ok" and line.fields.get("nonce") == nonce:
                    return line.fields
        raise LinkFault("the input is not from a tracker bridge")

    def _exchange(self, verb: str, fields: Fields, until_s: float) -> Fields:
        """Send one command and return its answer. Raises ``LinkFault``, ``_Busy``, or the tracker's error."""
        sequence = self._next_sequence()
        try:
            line = wire.encode(sequence, verb, fields)
        except ValueError as error:
            raise NotReady(f"tracker bridge {self._url}: {error}") from error
        self._write(line)
        for _ in range(_MAX_STALE_LINES):
            raw = self._raw_line(min(until_s, time.monotonic() + self._timeout_s))
            try:
                answer = wire.decode(raw)
            except Garbled as error:
                raise LinkFault(f"a damaged line came ({error})") from error
            if answer.sequence == 0 and answer.word == "error":
                raise LinkFault(answer.fields.get("text", "the bridge did not understand"))
            if answer.sequence != sequence:
                continue  # an answer to an abandoned command
            if answer.word == "wait":
                self._sign_of_life(answer.fields)
                if self._halting.is_set() and verb in _HALTABLE:
                    self._write(wire.encode(self._next_sequence(), "halt"))
                continue
            if answer.word == "ok":
                if verb in _FROM_TRACKER:
                    self._sign_of_life({})
                return answer.fields
            self._raise_error(verb, answer)
        raise LinkFault("only answers to other commands came")

    def _sign_of_life(self, fields: Fields) -> None:
        """Note a sign of life: ``age`` seconds old if the bridge reports an age, else now."""
        age_s = 0.0
        with contextlib.suppress(BadField):
            age_s = wire.read_optional(fields, "age", 0.0) or 0.0
        self._sign_s = max(self._sign_s, time.monotonic() - age_s)

    def _raise_error(self, verb: str, answer: WireLine) -> NoReturn:
        """Raise the exception that an ``error`` line encodes."""
        kind, text = answer.fields.get("kind", ""), answer.fields.get("text", "no reason was given")
        if kind == "busy":
            raise _Busy(text)
        if kind == "unprepared":
            raise _NotPrepared(text)
        if kind in ("no-session", "garbled"):
            raise LinkFault(text)
        if kind in ("held", "refused", "version"):
            self._close()
        if kind == "unknown-command":
            raise UnknownCommand(f"tracker bridge {self._url}: the bridge does not know '{verb}'")
        if kind == "bad-field":
            raise ValueError(f"tracker bridge {self._url}: '{verb}' was refused: {text}")
        raise wire.ERRORS.get(kind, TrackerError)(text)

    # -- bytes ---------------------------------------------------------------------------------------------------------

    def _next_sequence(self) -> int:
        with self._writing:
            self._sequence = self._sequence % wire.LAST_SEQUENCE + 1
            return self._sequence

    def _open(self, until_s: float) -> None:
        """Open the port in a separate thread. Raises ``Unreachable``.

        Name resolution and some kinds of port have no time limit when opened. A port that opens too late is closed.
        """
        self._close_port()
        opening = PortOpener(self._url, self._baud, write_timeout_s=self._timeout_s)
        self._port = opening.wait(min(self._timeout_s, max(until_s - time.monotonic(), 0.0)))
        self._received.clear()

    def _write(self, data: bytes) -> None:
        with self._writing:
            if self._port is None:
                raise LinkFault("the link is closed")
            try:
                self._port.write(data)
            except (serial.SerialException, OSError) as error:
                raise LinkFault(f"the link broke: {error}") from error

    def _raw_line(self, until_s: float) -> bytes:
        """Return the next line with its line end. Raises ``LinkFault`` if none arrives in time or it is too long.

        Silence counts only while this process was scheduled, and only after all pending input was read.
        """
        began_s = time.monotonic()
        looked_s, looking_s = began_s, 0.0
        while True:
            end = self._received.find(b"\n") + 1
            if end:
                raw = bytes(self._received[:end])
                del self._received[:end]
                return raw
            if len(self._received) > wire.LONGEST_LINE:
                raise LinkFault(f"a line longer than {wire.LONGEST_LINE} bytes came")
            port = self._port
            if port is None:
                raise LinkFault("the link is closed")
            try:
                self._received += port.read(1)
                self._received += waiting(port)
            except (serial.SerialException, OSError) as error:
                if b"\n" in self._received:
                    continue  # lines that came before the connection closed
                raise LinkFault(f"the link broke: {error}") from error
            now_s = time.monotonic()
            looking_s += min(now_s - looked_s, READ_TIMEOUT_S)
            looked_s = now_s
            enough = looking_s >= _SILENT_SHARE * (until_s - began_s)
            if now_s > until_s and enough and b"\n" not in self._received:
                raise _Silent(f"no answer within {self._timeout_s:g} s")

    def _close(self) -> None:
        self._close_port()
        self._out_of_sync = False

    def _close_port(self) -> None:
        with self._writing:
            port, self._port = self._port, None
        if port is not None:
            shut_down(port)


def _smr_fields(expected_M: NDArray[np.float64], name: str, time_s: float) -> dict[str, str]:
    """Return the fields of a command about an SMR under a new id; ``name`` is that of the field with ``time_s`` [s].

    Raises ``ValueError`` for an invalid point or time.
    """
    x, y, z = (wire.number(value) for value in checked_point(expected_M, time_s, _LONGEST_COMMAND_S))
    return {"id": wire.new_id(), "x": x, "y": y, "z": z, name: wire.number(time_s)}


@contextlib.contextmanager
def _known(track: _Running) -> Iterator[None]:
    """Raise ``TrackerLinkLost`` if the bridge does not know the track: it has restarted."""
    try:
        yield
    except ValueError as error:
        track.on = False
        raise TrackerLinkLost(str(error)) from error


def _nobody(error: TrackerError) -> None:
    """Ignore the error of a track that is over."""
