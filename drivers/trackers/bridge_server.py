"""The tracker's end of the bridge: serves any ``Tracker`` to one client at a time over TCP, a serial port, or both.

This module holds the sessions and commands of the protocol (BRIDGE.md). One thread handles all links and never waits
for one of them (``bridge_links``); another thread alone calls the tracker.
"""

from __future__ import annotations

import contextlib
import ipaddress
import logging
import math
import queue
import secrets
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge_links import JOIN_S, Link, LinkServer, RateLimitedLog
from drivers.trackers.bridge_token import usable_token
from drivers.trackers.bridge_wire import BadField, Fields, Garbled, WireLine
from drivers.trackers.protocol import (
    Halted,
    Preparation,
    Track,
    Tracker,
    TrackerError,
    TrackerLinkLost,
    stream_limits_of,
    stream_of,
)

# -- The only thread that calls the tracker behind a bridge: one command at a time, reconnecting after a lost link ----


_RECONNECT_S = 0.2

Reply = tuple[str, Fields]
"""Word and fields of an answer."""


@dataclass(eq=False)
class TrackerCall:
    """One command for the tracker. The worker's thread sets ``reply``; any thread may set ``halted``."""

    verb: str
    function: Callable[[], dict[str, str]]
    halted: bool = False
    reply: Reply | None = None


class TrackerWorker:
    """Runs calls of one tracker on one thread."""

    def __init__(
        self,
        tracker: Tracker,
        *,
        lock: AbstractContextManager[object] | None,
        recover_s: float,
        finished: Callable[[], None],
    ) -> None:
        """Hold ``lock`` in every call; retry a lost tracker for ``recover_s``; call ``finished`` after each call."""
        self._tracker = tracker
        self._lock = contextlib.nullcontext() if lock is None else lock
        self._recover_s = recover_s
        self._finished = finished
        self._calls: queue.SimpleQueue[TrackerCall | None] = queue.SimpleQueue()
        self._closing = threading.Event()
        self._connected = False
        self._settings: Preparation | None = None
        self._log = RateLimitedLog()
        self._thread = threading.Thread(target=self._run, name="tracker", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def submit(self, call: TrackerCall) -> None:
        """Queue a call."""
        self._calls.put(call)

    def prepare(self, settings: Preparation) -> None:
        """Prepare the tracker now and after every reconnect; only functions of calls may use this."""
        self._tracker.prepare(settings)
        self._settings = settings

    def close(self) -> None:
        """Halt the tracker, disconnect it and end the thread. A tracker that hangs is abandoned after some seconds."""
        self._closing.set()
        self._tracker.halt()
        self._calls.put(None)
        if self._thread.is_alive():
            self._thread.join(JOIN_S)

    def _run(self) -> None:
        while True:
            call = self._calls.get()
            if call is None or self._closing.is_set():
                break
            call.reply = self._reply(call)
            self._finished()
        if self._connected:
            with contextlib.suppress(TrackerError), self._lock:  # the tracker is abandoned in any case
                self._tracker.disconnect()

    def _reply(self, call: TrackerCall) -> Reply:
        """Run a call and return its answer. An unexpected exception is a defect of the tracker's driver: log it."""
        try:
            fields = self._execute(call)
            wire.encode(0, "ok", fields)  # fields too long for a line are a defect too
            return "ok", fields
        except (TrackerError, ValueError) as error:
            return "error", wire.error_fields(error)
        except Exception:
            LOG.exception("the tracker's driver broke down in '%s'", call.verb)
            self._connected = False
            return "error", {"kind": "failed", "text": "the tracker's driver broke down; see the bridge's log"}

    def _execute(self, call: TrackerCall) -> dict[str, str]:
        """Call the tracker; after a lost link reconnect, prepare it as before and call again.

        Only ``confirm`` reports a lost link at once; the next command reconnects.
        """
        until_s = time.monotonic() + self._recover_s
        while True:
            if call.halted:
                raise Halted("tracker: a halt was requested; no measurement was made")
            try:
                with self._lock:
                    if not self._connected:
                        self._tracker.connect()
                        if self._settings is not None and call.verb != "prepare":
                            self._tracker.prepare(self._settings)
                        self._connected = True
                    return call.function()
            except TrackerLinkLost as error:
                self._connected = False
                if call.verb == "confirm" or time.monotonic() >= until_s or self._closing.is_set():
                    raise
                self._log.warning("reconnecting to the tracker: %s", error)
            self._closing.wait(_RECONNECT_S)


# -- The points of a moving SMR, kept until the client has confirmed them ---------------------------------------------


@dataclass(frozen=True)
class _Waiting:
    """Points of one line, and their arrival time at the bridge."""

    points: tuple[str, ...]
    arrived_s: float


class TrackBuffer:
    """Buffer of the points of a track that the client has not confirmed yet. From any thread.

    Lines are numbered; a request for line k confirms all lines before it.
    """

    def __init__(self, id_: str) -> None:
        self.id = id_
        self._lock = threading.Lock()
        self._lines: deque[_Waiting] = deque()
        self._first = 0
        self._waiting = 0
        self._last_stamp_s = -math.inf
        self._lost: TrackerError | None = None

    def received(self, packet: Track) -> None:
        """Buffer the points that are newer than those before: of a packet, or of the whole track at its end."""
        with self._lock:
            packet = packet.within(packet.device_time_s > self._last_stamp_s)
            count = len(packet.device_time_s)
            if self._waiting + count > wire.MOST_WAITING or not count:
                return
            self._last_stamp_s = float(packet.device_time_s[-1])
            self._waiting += count
            self._lines += [_Waiting(points, time.monotonic()) for points in wire.packet_lines(packet)]

    def lost(self, error: TrackerError) -> None:
        """Note that the track was lost: it has ended by itself."""
        with self._lock:
            self._lost = self._lost or error

    def fields(self, number: int) -> dict[str, str]:
        """Return the answer to ``points from=number``. Raises ``BadField`` for a line that is no longer buffered."""
        with self._lock:
            while self._first < number and self._lines:
                self._waiting -= len(self._lines.popleft().points)
                self._first += 1
            if number != self._first:
                raise BadField(f"from is {number}; the next line is {self._first}")
            if not self._lines:
                why = {} if self._lost is None else wire.error_fields(self._lost)
                ended = {f"lost.{key}": text for key, text in why.items()}
                return {"points": "", "waiting": "0", "next": str(number), **ended}
            line = self._lines[0]
            return {
                "points": ";".join(line.points),
                "age": f"{max(time.monotonic() - line.arrived_s, 0.0):.6f}",
                "waiting": str(self._waiting - len(line.points)),
                "next": str(number + 1),
            }


LOG = logging.getLogger(__name__)

_POLL_S = 0.2
_HEARTBEAT_S = 0.2
"""Period of ``wait`` lines while the tracker executes a command; specified in BRIDGE.md."""
_OLDEST_S = 1e6
"""Age that is reported for a tracker without any sign of life."""
_MAX_RESULTS = 64
"""Number of stored results for clients that repeat a command; specified in BRIDGE.md."""
_STREAMING = ("stream-limits", "track", "end-track")
_COMMANDS = ("identify", "unmet", "confirm", "prepare", "measure", *_STREAMING)
"""Commands that the tracker answers."""
_MEASURING = ("measure", "track")
_MAX_BAD_LINES = 20
_NOTICE_S = 0.2
"""Shortest time between two ``garbled`` errors, so that noise does not cause a flood of answers."""


@dataclass(eq=False)
class _ActiveCommand:
    """The command that the tracker executes, and the link that waits for its answer (None if no client waits)."""

    id: str
    call: TrackerCall
    began_s: float
    link: Link | None
    sequence: int
    heartbeat_s: float
    overdue: bool = False


def is_loopback(host: str) -> bool:
    """Return whether an address is reachable only from this machine."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class TrackerService:
    """Server of one tracker. Use ``with`` (a background thread handles the links), or call ``open`` and then ``poll``.

    Attributes
    ----------
    host, port : str, int
        Address at which it listens once it is open.
    """

    def __init__(
        self,
        tracker: Tracker,
        *,
        host: str = "127.0.0.1",
        port: int | None = 0,
        serial_url: str | None = None,
        baud: int = 115200,
        token: str | None = None,
        lock: AbstractContextManager[object] | None = None,
        command_s: float = 120.0,
        recover_s: float = 60.0,
        idle_s: float = 30.0,
        hello_s: float = 5.0,
        line_s: float = 10.0,
        max_links: int = 32,
    ) -> None:
        """Configure the service; nothing is opened yet.

        Parameters
        ----------
        host, port
            TCP address to listen at; port 0 takes a free one, None does not listen.
        serial_url, baud
            Serial port to serve as well, by any name or URL that pyserial accepts.
        token
            Shared secret; without one only loopback addresses are allowed.
        lock
            Held during every call of the tracker except ``halt``.
        command_s, recover_s
            Time limit of a command, and how long a lost tracker is retried.
        idle_s
            A client that was silent for this long loses the tracker to another one that asks.
        hello_s, line_s
            Time limits until a session is open, and until a line is finished.
        max_links
            Connections without a session that are kept at once.

        Raises ``ValueError`` for an address beyond loopback without a token, or a token that is too short.
        """
        if token is not None:
            token = usable_token(token)
        elif port is not None and not is_loopback(host):
            raise ValueError(
                f"{host} is not a loopback address: anyone who reaches it could take the tracker. Give the bridge a"
                " token"
            )
        self.host = host
        self.port = port
        self._tracker = tracker
        self._token = token
        self._serial_url, self._baud = serial_url, baud
        self._limit_s, self._idle_s = command_s + recover_s, idle_s
        self._links = LinkServer(self, hello_s=hello_s, line_s=line_s, max_links=max_links)
        self._worker = TrackerWorker(tracker, lock=lock, recover_s=recover_s, finished=self._links.wake)
        self._log = RateLimitedLog()
        self._boot = secrets.token_hex(8)
        self._results: OrderedDict[str, Reply] = OrderedDict()
        self._holder: Link | None = None
        self._active: _ActiveCommand | None = None
        self._prepared_for = ""
        self._track: TrackBuffer | None = None
        """The newest track; the tracker's thread begins it, that of the links answers ``points``."""
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    # -- opening and closing -------------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        self.open()
        self._thread = threading.Thread(target=self._run, name="tracker bridge", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """URL under which a client on this machine reaches the bridge through pyserial."""
        return f"socket://{self.host}:{self.port}"

    def open(self) -> None:
        """Start listening. Raises ``OSError`` if the address is not available; then nothing stays open."""
        self.port = self._links.open(self.host, self.port, self._serial_url, self._baud)
        self._worker.start()

    def close(self) -> None:
        """Disconnect all clients, release the tracker, free all ports. Waits at most some seconds for each thread."""
        self._closing.set()
        self._links.wake()
        if self._thread is not None:
            self._thread.join(JOIN_S)
        self._worker.close()
        self._links.close()

    def poll(self, timeout_s: float = 0.0) -> None:
        """Handle all links once; wait for input at most ``timeout_s``."""
        active = self._active
        if active is not None:
            timeout_s = min(timeout_s, max(active.heartbeat_s + _HEARTBEAT_S - time.monotonic(), 0.0))
        self._links.poll(timeout_s)
        self._check_active()
        self._links.enforce_limits()

    def call_soon(self, action: Callable[[], None]) -> None:
        """Run ``action`` in the thread that handles the links; from any thread."""
        self._links.call_soon(action)

    def restart(self) -> None:
        """Disconnect all clients and forget all results, like a restart of the computer. Only in the links' thread."""
        self._boot = secrets.token_hex(8)
        self._results.clear()
        self._prepared_for = ""
        self._track = None
        if self._active is not None:
            self._active.id = ""
        for link in list(self._links.links):
            self._links.drop(link, "the bridge restarts", at_once=True)

    def _run(self) -> None:
        while not self._closing.is_set():
            self.poll(_POLL_S)

    # -- what the links report -----------------------------------------------------------------------------------------

    def accepts_connections(self) -> bool:
        """Return whether new connections are accepted now."""
        return True

    def line_received(self, link: Link, raw: bytes) -> None:
        """Decode and execute a line."""
        if not raw.strip(b"\r"):
            return  # an empty line ends any partial line that noise has left
        try:
            line = wire.decode(raw)
        except Garbled as error:
            self.bad_line(link, str(error))
            return
        link.last_line_s = time.monotonic()
        try:
            self._dispatch(link, line)
        except BadField as error:
            self._error(link, line.sequence, "bad-field", str(error))

    def bad_line(self, link: Link, reason: str) -> None:
        """Answer that input was not understood, at a limited rate; drop a client that sends nothing valid."""
        now = time.monotonic()
        link.bad_lines += 1
        if link.state != "holding" and not link.permanent and link.bad_lines > _MAX_BAD_LINES:
            self._links.drop(link, "it does not use the bridge protocol")
        elif now - link.last_notice_s > _NOTICE_S:
            link.last_notice_s = now
            self._error(link, 0, "garbled", f"not understood: {reason}; send 'sync' before the next command")

    def session_ended(self, link: Link, reason: str) -> None:
        """Release the tracker if this link held it; its command continues, for a client that reconnects."""
        if link.state == "holding":
            LOG.info("the tracker is free again: %s: %s", link.peer, reason)
        else:
            self._log.warning("%s: %s", link.peer, reason)
        if self._holder is link:
            self._holder = None
        if self._active is not None and self._active.link is link:
            self._active.link = None

    # -- commands ------------------------------------------------------------------------------------------------------

    def _error(self, link: Link, sequence: int, kind: str, text: str) -> None:
        self._answer(link, sequence, ("error", {"kind": kind, "text": wire.text(text)}))

    def _answer(self, link: Link, sequence: int, reply: Reply) -> None:
        word, fields = reply
        self._links.send(link, wire.encode(sequence, word, fields))

    def _dispatch(self, link: Link, line: WireLine) -> None:
        busy = {"busy": str(int(self._active is not None))}
        match line.word:
            case "sync":
                nonce = wire.read_id(line.fields, "nonce")
                state = {"nonce": nonce, "boot": self._boot, "holding": str(int(link.state == "holding"))}
                self._answer(link, line.sequence, ("ok", state | busy))
            case "hello":
                self._hello(link, line)
            case "auth" if link.state == "challenged":
                self._auth(link, line)
            case _ if link.state != "holding":
                self._without_session(link, line)
            case "ping":
                self._answer(link, line.sequence, ("ok", busy))
            case "halt":
                if self._active is not None:
                    self._active.call.halted = True
                self._tracker.halt()
                self._answer(link, line.sequence, ("ok", {}))
            case "bye":
                self._answer(link, line.sequence, ("ok", {}))
                self._links.drop(link, "the client ended its session")
            case "points":
                number = int(wire.read_number(line.fields, "from", 0, 1e9))
                self._answer(link, line.sequence, ("ok", self._known_track(line.fields).fields(number)))
            case verb if verb in _COMMANDS:
                self._command(link, line)
            case _:
                self._error(link, line.sequence, "unknown-command", f"unknown command '{line.word}'")

    def _without_session(self, link: Link, line: WireLine) -> None:
        """Refuse a command on a link that has no session."""
        link.bad_lines += 1
        self._error(link, line.sequence, "no-session", "send 'hello' first: this connection does not hold the tracker")
        if link.bad_lines > _MAX_BAD_LINES and not link.permanent:
            self._links.drop(link, "it sends commands without a session")

    # -- sessions ------------------------------------------------------------------------------------------------------

    def _hello(self, link: Link, line: WireLine) -> None:
        version = line.fields.get("protocol", "")
        if version != str(wire.VERSION):
            self._error(link, line.sequence, "version", f"this bridge supports version {wire.VERSION}, not '{version}'")
            return
        client = wire.read_id(line.fields, "client")
        if link.state == "holding" and client != link.client:
            self._links.drop(link, "another client sent a hello on its link")
        if link.closing:
            return
        link.client = client
        reply = {
            "protocol": str(wire.VERSION),
            "boot": self._boot,
            "longest": wire.number(self._limit_s),
            "auth": "none",
        }
        if self._token is None:
            if self._admit(link, line.sequence):
                self._answer(link, line.sequence, ("ok", reply))
            return
        if self._holder is link:
            self._holder = None
        link.state, link.nonce = "challenged", secrets.token_hex(16)
        self._answer(link, line.sequence, ("ok", reply | {"auth": "hmac-sha256", "nonce": link.nonce}))

    def _auth(self, link: Link, line: WireLine) -> None:
        assert self._token is not None
        client_nonce = wire.read_id(line.fields, "nonce")
        given = line.fields.get("proof", "")
        nonce, link.nonce, link.state = link.nonce, "", "new"  # one attempt per challenge
        if not wire.proofs_equal(given, wire.proof(self._token, "client", link.client, nonce, client_nonce)):
            self._log.warning("%s: refused: it does not know the token", link.peer)
            text = "the token is wrong: the client's must be the same as the bridge's"
            self._error(link, line.sequence, "refused", text)
            self._links.drop(link, "wrong token")
        elif self._admit(link, line.sequence):
            ours = wire.proof(self._token, "server", link.client, nonce, client_nonce)
            self._answer(link, line.sequence, ("ok", {"proof": ours}))

    def _admit(self, link: Link, sequence: int) -> bool:
        """Give the tracker to the client of a link, unless another client holds it; return whether it was given."""
        holder, now = self._holder, time.monotonic()
        if holder is not None and holder is not link:
            at_work = self._active is not None and self._active.link is holder
            silent_s = 0.0 if at_work else now - holder.last_line_s
            if holder.client != link.client and silent_s <= self._idle_s:
                self._error(
                    link,
                    sequence,
                    "held",
                    f"the tracker is held by {holder.peer}, which was last heard {silent_s:.0f} s ago; end that client,"
                    f" or wait until it has been silent for {self._idle_s:.0f} s",
                )
                self._links.drop(link, f"refused: the tracker is held by {holder.peer}")
                return False
            same = holder.client == link.client
            self._links.drop(holder, "it came back on another link" if same else "it was silent and another one asked")
        self._holder, link.state, link.bad_lines = link, "holding", 0
        LOG.info("the tracker is held by %s", link.peer)
        return True

    # -- commands for the tracker --------------------------------------------------------------------------------------

    def _command(self, link: Link, line: WireLine) -> None:
        """Start a command; if its id is known, answer with its stored or pending result."""
        verb = line.word
        measures = verb in _MEASURING
        id_ = wire.read_id(line.fields) if measures or "id" in line.fields else ""
        active = self._active
        if id_ and id_ in self._results:
            self._answer(link, line.sequence, self._results[id_])
        elif id_ and active is not None and active.id == id_:
            active.link, active.sequence = link, line.sequence
        elif active is not None:
            advice = "it does not end: restart the bridge" if active.overdue else "wait for it, or halt it"
            self._error(link, line.sequence, "busy", f"the tracker is at work on a '{active.call.verb}'; {advice}")
        elif measures and self._prepared_for != link.client:
            self._error(link, line.sequence, "unprepared", "send 'prepare' first; another client may have had it")
        else:
            call = TrackerCall(verb, self._function(verb, line.fields, link.client))
            now = time.monotonic()
            self._active = _ActiveCommand(id_, call, now, link, line.sequence, heartbeat_s=now)
            self._worker.submit(call)

    def _function(self, verb: str, fields: Fields, client: str) -> Callable[[], dict[str, str]]:
        """Return the function that the worker must call for a command. Raises ``BadField``."""
        tracker = self._tracker
        match verb:
            case "identify":
                return lambda: wire.identity_fields(tracker.identify())
            case "unmet":
                return lambda: wire.unmet_fields(tracker.unmet())
            case "confirm":
                within_s = wire.read_number(fields, "within", 1e-3, 60.0)
                return lambda: self._confirm(within_s)
            case "stream-limits":
                return lambda: wire.limits_fields(stream_limits_of(tracker))
            case "end-track":
                return partial(self._end_track, self._known_track(fields))
            case "prepare":
                try:
                    settings = wire.read_preparation(fields)
                except ValueError as error:
                    raise BadField(str(error)) from error
                return lambda: self._prepare(settings, client)
            case _:
                expected_M = np.array([wire.read_number(fields, axis, -1e3, 1e3) for axis in ("x", "y", "z")])
                if verb == "track":
                    id_, interval_s = fields["id"], wire.read_number(fields, "interval", 1e-4, 60.0)
                    return lambda: self._start_track(id_, expected_M, interval_s)
                averaging_s = wire.read_number(fields, "averaging", 1e-3, 600.0)
                return lambda: wire.point_fields(tracker.measure(expected_M, averaging_s))

    def _confirm(self, within_s: float) -> dict[str, str]:
        """Check that the tracker itself answers; runs in the worker's thread."""
        self._tracker.confirm(within_s)
        return {}

    def _prepare(self, settings: Preparation, client: str) -> dict[str, str]:
        """Prepare the tracker for a client; runs in the worker's thread."""
        self._prepared_for = ""
        self._worker.prepare(settings)
        self._prepared_for = client
        return {}

    def _known_track(self, fields: Fields) -> TrackBuffer:
        """Return the track named by a line. Raises ``BadField`` unless it is the newest one."""
        track, id_ = self._track, wire.read_id(fields, "track")
        if track is None or track.id != id_:
            raise BadField("no such track: the bridge has restarted, or another one was begun")
        return track

    def _start_track(self, id_: str, expected_M: NDArray[np.float64], interval_s: float) -> dict[str, str]:
        """Start a track of an SMR, in the worker's thread. Raises as ``start_track``."""
        if (streaming := stream_of(self._tracker)) is None:
            raise ValueError("this tracker does not measure an SMR while it moves")
        track = TrackBuffer(id_)
        streaming.start_track(expected_M, interval_s, track.lost, track.received)
        self._track = track
        return {}

    def _end_track(self, track: TrackBuffer) -> dict[str, str]:
        """End a track, in the worker's thread; its points stay buffered."""
        if (streaming := stream_of(self._tracker)) is not None:
            track.received(streaming.end_track())
        return {}

    def _check_active(self) -> None:
        """Deliver the answer of a finished command; else send a heartbeat, or halt a command that takes too long."""
        active, now = self._active, time.monotonic()
        if active is None:
            return
        reply = active.call.reply
        if reply is not None:
            self._active = None
            if active.overdue and reply[0] == "error":  # the halt below caused the error
                reply = self._timed_out(active)
            if active.id:
                self._keep_result(active.id, reply)
            if active.link is not None:
                self._deliver(active.link, active.sequence, reply)
        elif not active.overdue and now - active.began_s > self._limit_s:
            active.overdue = active.call.halted = True
            self._tracker.halt()
            if active.link is not None:
                self._deliver(active.link, active.sequence, self._timed_out(active))
                active.link = None
        elif active.link is not None and now - active.heartbeat_s >= _HEARTBEAT_S:
            active.heartbeat_s = now
            age_s = min(max(self._tracker.data_age_s(), 0.0), _OLDEST_S)  # that of the tracker itself
            fields = {"elapsed": f"{now - active.began_s:.1f}", "age": f"{age_s:.3f}"}
            self._answer(active.link, active.sequence, ("wait", fields))

    def _timed_out(self, active: _ActiveCommand) -> Reply:
        text = f"the tracker did not finish '{active.call.verb}' within {self._limit_s:g} s; a halt was requested"
        return "error", {"kind": "timeout", "text": text}

    def _deliver(self, link: Link, sequence: int, reply: Reply) -> None:
        """Send the tracker's answer; the emulator overrides this to inject faults."""
        self._answer(link, sequence, reply)

    def _keep_result(self, id_: str, reply: Reply) -> None:
        self._results[id_] = reply
        while len(self._results) > _MAX_RESULTS:
            self._results.popitem(last=False)
