"""The tracker's end of the bridge: serves any ``Tracker`` to one client at a time over TCP, a serial port, or both.

One thread looks after all links and never waits for any of them; another one alone speaks with the tracker, so that its
calls come one at a time and always from the same thread. BRIDGE.md describes what is said on the wire.
"""

from __future__ import annotations

import contextlib
import ipaddress
import logging
import secrets
import selectors
import socket
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Literal, Self

import numpy as np
import serial

from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge_wire import BadField, Fields, Garbled, Line
from drivers.trackers.protocol import Halted, Preparation, Tracker, TrackerError, TrackerLinkLost

LOG = logging.getLogger(__name__)

_TURN_S = 0.2
_HEARTBEAT_S = 1.0
_READ_AT_ONCE = 8192
_MOST_WAITING_OUT = 65536
_MOST_KEPT = 64
_MOST_BAD_LINES = 20
_NOTICE_S = 0.2
_RECONNECT_S = 0.2
_REOPEN_SERIAL_S = 2.0
_JOIN_S = 5.0
_LOG_S = 1.0
_NEVER = -1e9

State = Literal["new", "challenged", "holding"]
Reply = tuple[str, Fields]
_Call = Callable[[], dict[str, str]]


@dataclass(eq=False)
class Link:
    """One connection and what is known of who speaks there."""

    socket: socket.socket
    peer: str
    permanent: bool  # a serial port, which cannot be hung up
    opened_s: float
    state: State = "new"
    client: str = ""
    nonce: str = ""
    held: bytearray = field(default_factory=bytearray)
    out: bytearray = field(default_factory=bytearray)
    skipping: bool = False  # the rest of a line that was too long
    line_began_s: float = 0.0
    heard_s: float = 0.0
    noticed_s: float = _NEVER
    bad_lines: int = 0
    leaving: bool = False


@dataclass(eq=False)
class _Job:
    """One command for the tracker, and who waits for its answer."""

    verb: str
    id: str
    call: _Call
    began_s: float
    link: Link | None
    sequence: int
    beat_s: float
    overdue: bool = False
    halted: bool = False
    reply: Reply | None = None


def is_loopback(host: str) -> bool:
    """Whether an address is reachable from this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def usable_token(token: str) -> str:
    """The token without blanks around it. Raises ``ValueError`` if it is too short or not printable ASCII."""
    token = token.strip()
    if len(token) < wire.SHORTEST_TOKEN or not token.isascii() or not token.isprintable():
        raise ValueError(
            f"the bridge's token must be at least {wire.SHORTEST_TOKEN} printable ASCII characters; make one with:"
            ' python -c "import secrets; print(secrets.token_hex(32))"'
        )
    return token


class TrackerService:
    """Serves a tracker. Use ``with`` (a thread of its own looks after the links), or ``open`` and then ``poll``.

    Attributes
    ----------
    host, port : str, int
        Where it listens once it is open.
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
        most_links: int = 32,
    ) -> None:
        """Prepare to serve ``tracker``.

        Parameters
        ----------
        host, port
            Where to listen; port 0 takes a free one, None does not listen at all.
        serial_url, baud
            A serial port to serve as well, by any name or URL that pyserial knows.
        token
            Shared secret; without one only loopback addresses are served.
        lock
            Held during every call of the tracker but ``halt``.
        command_s, recover_s
            How long a command may take before the client is told so, and how long a lost tracker is sought again.
        idle_s
            A client that was silent for this long loses the tracker to another one that asks.
        hello_s, line_s
            How long a client may take to introduce itself, and to finish a line.

        Raises ``ValueError`` for an address beyond loopback without a token, or a token that is too short.
        """
        if token is not None:
            token = usable_token(token)
        elif port is not None and not is_loopback(host):
            raise ValueError(
                f"{host} is not a loopback address: whoever reaches it could take the tracker. Give the bridge a token"
            )
        self.host = host
        self.port = port
        self._tracker = tracker
        self._token = token
        self._serial_url, self._baud = serial_url, baud
        self._lock = contextlib.nullcontext() if lock is None else lock
        self._command_s, self._recover_s, self._idle_s = command_s, recover_s, idle_s
        self._hello_s, self._line_s, self._most_links = hello_s, line_s, most_links
        self._boot = secrets.token_hex(8)
        self._kept: OrderedDict[str, Reply] = OrderedDict()
        self._links: list[Link] = []
        self._holder: Link | None = None
        self._job: _Job | None = None
        self._soon: deque[Callable[[], None]] = deque()
        self._logged: dict[str, tuple[float, int]] = {}
        self._selector: selectors.BaseSelector | None = None
        self._listening: socket.socket | None = None
        self._wake: socket.socket | None = None
        self._woken: socket.socket | None = None
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None
        self._pumps: list[_SerialPump] = []
        self._prepared_for = ""
        # what the tracker's thread alone touches
        self._jobs: deque[_Job] = deque()
        self._work = threading.Semaphore(0)
        self._worker: threading.Thread | None = None
        self._reached = False
        self._settings: Preparation | None = None

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
        """What a client on this machine gives pyserial."""
        return f"socket://{self.host}:{self.port}"

    def open(self) -> None:
        """Listen. Raises ``OSError`` if the address cannot be had; then nothing is left open."""
        with contextlib.ExitStack() as stack:
            self._selector = selectors.DefaultSelector()
            stack.callback(self._selector.close)
            self._wake, self._woken = socket.socketpair()
            for end in (self._wake, self._woken):
                stack.callback(end.close)
                end.setblocking(False)
            self._selector.register(self._woken, selectors.EVENT_READ)
            if self.port is not None:
                family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
                listening = stack.enter_context(socket.socket(family, socket.SOCK_STREAM))
                listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                try:
                    listening.bind((self.host, self.port))
                    listening.listen(128)
                except OSError as error:
                    raise OSError(
                        error.errno, f"cannot listen at {self.host} port {self.port}: {error.strerror}"
                    ) from error
                listening.setblocking(False)
                self.port = listening.getsockname()[1]
                self._listening = listening
                self._selector.register(listening, selectors.EVENT_READ)
            if self._serial_url is not None:
                here, there = socket.socketpair()
                self._add(here, "the serial port", permanent=True)
                self._pumps.append(_SerialPump(self._serial_url, self._baud, there))
            stack.pop_all()
        for pump in self._pumps:
            pump.start()
        self._start_worker()

    def close(self) -> None:
        """Let every client go, release the tracker, free all ports. A tracker that hangs is not waited for long."""
        self._closing.set()
        self._awake()
        if self._thread is not None:
            self._thread.join(_JOIN_S)
        self._tracker.halt()
        self._work.release()
        if self._worker is not None:
            self._worker.join(_JOIN_S)
        for pump in self._pumps:
            pump.close()
        for link in list(self._links):
            self._drop(link, "the bridge is closed", forever=True)
        for end in (self._listening, self._wake, self._woken, self._selector):
            if end is not None:
                end.close()
        self._listening = self._wake = self._woken = None

    def _run(self) -> None:
        while not self._closing.is_set():
            self.poll(_TURN_S)

    def _awake(self) -> None:
        wake = self._wake
        if wake is not None:
            with contextlib.suppress(BlockingIOError, OSError):  # full: it wakes anyway; closed: nobody sleeps
                wake.send(b"\0")

    # -- links ---------------------------------------------------------------------------------------------------------

    def soon(self, act: Callable[[], None]) -> None:
        """Have something done by the thread that looks after the links."""
        self._soon.append(act)
        self._awake()

    def poll(self, timeout_s: float = 0.0) -> None:
        """Look after all links once, and wait at most ``timeout_s`` for something to do."""
        assert self._selector is not None, "open it first"
        for key, _ in self._selector.select(timeout_s):
            if key.fileobj is self._woken:
                with contextlib.suppress(BlockingIOError):
                    self._woken.recv(4096)
            elif key.fileobj is self._listening:
                self._accept()
            elif key.data in self._links:  # it may have been dropped a moment ago
                self._read(key.data)
        while self._soon:
            self._soon.popleft()()
        self._look_after_job()
        now = time.monotonic()
        for link in list(self._links):
            self._look_after(link, now)

    def _add(self, opened: socket.socket, peer: str, *, permanent: bool) -> Link:
        assert self._selector is not None
        opened.setblocking(False)
        now = time.monotonic()
        link = Link(opened, peer, permanent, opened_s=now, heard_s=now)
        self._links.append(link)
        self._selector.register(opened, selectors.EVENT_READ, link)
        return link

    def _accept(self) -> None:
        assert self._listening is not None
        try:
            opened, address = self._listening.accept()
        except OSError:  # it went before it was let in, or there are no descriptors left
            return
        strangers = [link for link in self._links if link.state != "holding" and not link.permanent]
        if len(strangers) >= self._most_links:  # the oldest has had its chance; who holds the tracker stays
            self._drop(strangers[0], "there are too many connections", forever=True)
        with contextlib.suppress(OSError):
            opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._add(opened, f"{address[0]}:{address[1]}", permanent=False)

    def _read(self, link: Link) -> None:
        try:
            data = link.socket.recv(_READ_AT_ONCE)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(link, f"the link broke: {error.strerror}", forever=True)
            return
        if not data:
            self._drop(link, "the client hung up", forever=True)
            return
        if link.leaving:
            return
        if not link.held and not link.skipping:
            link.line_began_s = time.monotonic()
        link.held += data
        while link in self._links and not link.leaving:
            raw, end, rest = link.held.partition(b"\n")
            if not end:
                break
            link.held = rest
            link.line_began_s = time.monotonic()
            if link.skipping:
                link.skipping = False
            else:
                self._hear(link, bytes(raw))
        if len(link.held) >= wire.LONGEST_LINE:
            link.held.clear()
            if not link.skipping:
                link.skipping = True
                self._bad_line(link, f"the line is longer than {wire.LONGEST_LINE} bytes")

    def _look_after(self, link: Link, now: float) -> None:
        if link.out and not link.leaving:
            self._send_out(link)
        if (link.held or link.skipping) and now - link.line_began_s > self._line_s:
            link.held.clear()
            link.skipping = False
            self._bad_line(link, f"a line was not finished within {self._line_s:g} s")
        stranger = link.state != "holding" and not link.permanent
        if link.leaving:
            if now - link.heard_s > self._hello_s:
                self._hang_up(link)
        elif stranger and now - link.opened_s > self._hello_s:
            self._drop(link, f"no introduction within {self._hello_s:g} s")

    def _send(self, link: Link, line: bytes) -> None:
        """Queue a line; a client that does not read loses its link."""
        link.out += line
        if len(link.out) > _MOST_WAITING_OUT:
            link.out.clear()
            self._drop(link, "it does not read what it is told", forever=True)
            return
        self._send_out(link)

    def _send_out(self, link: Link) -> None:
        try:
            sent = link.socket.send(link.out)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(link, f"the link broke: {error.strerror}", forever=True)
            return
        del link.out[:sent]

    def _drop(self, link: Link, why: str, *, forever: bool = False) -> None:
        """End with a client. Its last line is given time to arrive unless ``forever``; a serial port starts anew."""
        if link not in self._links:
            return
        if link.state == "holding":
            LOG.info("the tracker is free again: %s: %s", link.peer, why)
        else:
            self._complain("%s: %s", link.peer, why)
        if self._holder is link:
            self._holder = None
        if self._job is not None and self._job.link is link:
            self._job.link = None
        link.state, link.client, link.bad_lines = "new", "", 0
        if link.permanent and not self._closing.is_set():
            return
        if forever or link.leaving:
            self._hang_up(link)
            return
        link.leaving = True
        link.heard_s = time.monotonic()
        self._send_out(link)
        if link in self._links:
            with contextlib.suppress(OSError):  # it may have gone
                link.socket.shutdown(socket.SHUT_WR)

    def _hang_up(self, link: Link) -> None:
        if link in self._links:
            self._links.remove(link)
            assert self._selector is not None
            self._selector.unregister(link.socket)
            link.socket.close()

    def _complain(self, words: str, *details: object) -> None:
        """Log a stranger's doings, at most one line a second of each kind: a log must not fill a disk."""
        now = time.monotonic()
        last_s, left_out = self._logged.get(words, (_NEVER, 0))
        if now - last_s < _LOG_S:
            self._logged[words] = last_s, left_out + 1
            return
        more = f" (and {left_out} more like it)" if left_out else ""
        self._logged[words] = now, 0
        LOG.warning(words + more, *details)

    # -- lines ---------------------------------------------------------------------------------------------------------

    def _hear(self, link: Link, raw: bytes) -> None:
        if not raw.strip(b"\r"):
            return  # an empty line ends whatever half a line noise has left
        try:
            line = wire.decode(raw)
        except Garbled as error:
            self._bad_line(link, str(error))
            return
        link.heard_s = time.monotonic()
        try:
            self._obey(link, line)
        except BadField as error:
            self._error(link, line.sequence, "bad-field", str(error))

    def _bad_line(self, link: Link, why: str) -> None:
        """Say that something was not understood; not for every one of a flood of them."""
        now = time.monotonic()
        link.bad_lines += 1
        if link.state != "holding" and not link.permanent and link.bad_lines > _MOST_BAD_LINES:
            self._drop(link, "it does not speak the bridge protocol")
        elif now - link.noticed_s > _NOTICE_S:
            link.noticed_s = now
            self._error(link, 0, "garbled", f"not understood: {why}; send 'sync' before the next command")

    def _error(self, link: Link, sequence: int, kind: str, words: str) -> None:
        self._answer(link, sequence, ("error", {"kind": kind, "text": wire.text(words)}))

    def _answer(self, link: Link, sequence: int, reply: Reply) -> None:
        word, fields = reply
        self._send(link, wire.encode(sequence, word, fields))

    def _obey(self, link: Link, line: Line) -> None:
        match line.word:
            case "sync":
                nonce = wire.read_id(line.fields, "nonce")
                state = {"nonce": nonce, "boot": self._boot, "holding": str(int(link.state == "holding"))}
                self._answer(link, line.sequence, ("ok", state | {"busy": str(int(self._job is not None))}))
            case "hello":
                self._hello(link, line)
            case "auth" if link.state == "challenged":
                self._auth(link, line)
            case _ if link.state != "holding":
                self._stranger(link, line)
            case "ping":
                self._answer(link, line.sequence, ("ok", {"busy": str(int(self._job is not None))}))
            case "halt":
                if self._job is not None:
                    self._job.halted = True
                self._tracker.halt()
                self._answer(link, line.sequence, ("ok", {}))
            case "bye":
                self._answer(link, line.sequence, ("ok", {}))
                self._drop(link, "the client said goodbye")
            case "identify" | "unmet" | "prepare" | "inclination" | "measure" | "two-face":
                self._command(link, line)
            case _:
                self._error(link, line.sequence, "unknown-command", f"there is no command '{line.word}'")

    def _stranger(self, link: Link, line: Line) -> None:
        """A command of somebody who has not been let in."""
        link.bad_lines += 1
        self._error(link, line.sequence, "no-session", "say hello first: this connection does not hold the tracker")
        if link.bad_lines > _MOST_BAD_LINES and not link.permanent:
            self._drop(link, "it does not introduce itself")

    # -- who may speak -------------------------------------------------------------------------------------------------

    def _hello(self, link: Link, line: Line) -> None:
        spoken = line.fields.get("protocol", "")
        if spoken != str(wire.VERSION):
            self._error(link, line.sequence, "version", f"this bridge speaks version {wire.VERSION}, not '{spoken}'")
            return
        client = wire.read_id(line.fields, "client")
        if link.state == "holding" and client != link.client:
            self._drop(link, "another client speaks on its link")
        if link.leaving:
            return
        link.client = client
        reply = {
            "protocol": str(wire.VERSION),
            "boot": self._boot,
            "longest": wire.number(self._command_s + self._recover_s),
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

    def _auth(self, link: Link, line: Line) -> None:
        assert self._token is not None
        theirs = wire.read_id(line.fields, "nonce")
        given = line.fields.get("proof", "")
        nonce, link.nonce, link.state = link.nonce, "", "new"  # one try a challenge
        if not wire.same(given, wire.proof(self._token, "client", link.client, nonce, theirs)):
            self._complain("%s: refused: it does not know the token", link.peer)
            words = "the token is wrong: the client's must be the same as the bridge's"
            self._error(link, line.sequence, "refused", words)
            self._drop(link, "wrong token")
        elif self._admit(link, line.sequence):
            ours = wire.proof(self._token, "server", link.client, nonce, theirs)
            self._answer(link, line.sequence, ("ok", {"proof": ours}))

    def _admit(self, link: Link, sequence: int) -> bool:
        """Give the tracker to a client, unless another one has it."""
        holder, now = self._holder, time.monotonic()
        if holder is not None and holder is not link:
            at_work = self._job is not None and self._job.link is holder
            silent_s = 0.0 if at_work else now - holder.heard_s
            if holder.client != link.client and silent_s <= self._idle_s:
                self._error(
                    link,
                    sequence,
                    "held",
                    f"the tracker is held by {holder.peer}, which was last heard {silent_s:.0f} s ago; end that client,"
                    f" or wait until it has been silent for {self._idle_s:.0f} s",
                )
                self._drop(link, f"refused: the tracker is held by {holder.peer}")
                return False
            same = holder.client == link.client
            self._drop(holder, "it came back on another link" if same else "it was silent and another one asked")
        self._holder, link.state, link.bad_lines = link, "holding", 0
        LOG.info("the tracker is held by %s", link.peer)
        return True

    # -- commands for the tracker --------------------------------------------------------------------------------------

    def _command(self, link: Link, line: Line) -> None:
        """Start a command; where its id is known, give the answer that it had, or will have."""
        verb = line.word
        given = wire.read_id(line.fields) if verb in ("measure", "two-face") or "id" in line.fields else ""
        job = self._job
        if given and given in self._kept:
            self._answer(link, line.sequence, self._kept[given])
        elif given and job is not None and job.id == given:
            job.link, job.sequence = link, line.sequence
        elif job is not None:
            advice = "it does not end: restart the bridge" if job.overdue else "wait for it, or halt it"
            self._error(link, line.sequence, "busy", f"the tracker is at work on a '{job.verb}'; {advice}")
        elif verb in ("measure", "two-face") and self._prepared_for != link.client:
            self._error(link, line.sequence, "unprepared", "send 'prepare' first; another client may have had it")
        else:
            call = self._call(verb, line.fields, link.client)
            now = time.monotonic()
            self._job = _Job(verb, given, call, now, link, line.sequence, now)
            self._jobs.append(self._job)
            self._work.release()

    def _call(self, verb: str, fields: Fields, client: str) -> _Call:
        """What the tracker's thread shall do. Raises ``BadField``."""
        tracker = self._tracker
        match verb:
            case "identify":
                return lambda: wire.identity_fields(tracker.identify())
            case "unmet":
                return lambda: wire.unmet_fields(tracker.unmet())
            case "inclination":
                return lambda: wire.inclination_fields(tracker.inclination())
            case "prepare":
                try:
                    settings = wire.read_preparation(fields)
                except ValueError as error:
                    raise BadField(str(error)) from error
                return lambda: self._prepare(settings, client)
            case _:
                expected_M = np.array([wire.read_number(fields, axis, -1e3, 1e3) for axis in ("x", "y", "z")])
                averaging_s = wire.read_number(fields, "averaging", 1e-3, 600.0)
                if verb == "two-face":
                    return lambda: wire.two_face_fields(tracker.measure_two_face(expected_M, averaging_s))
                return lambda: wire.point_fields(tracker.measure(expected_M, averaging_s))

    def _prepare(self, settings: Preparation, client: str) -> dict[str, str]:
        self._prepared_for = ""
        self._tracker.prepare(settings)
        self._settings, self._prepared_for = settings, client
        return {}

    def _look_after_job(self) -> None:
        """Hand over an answer that is there; else say that it is being worked at, or that it takes too long."""
        job, now = self._job, time.monotonic()
        if job is None:
            return
        if job.reply is None and not self._worker_lives():
            job.reply = ("error", {"kind": "failed", "text": "the tracker's driver broke down; see the bridge's log"})
            self._reached = False
            self._start_worker()
        if job.reply is not None:
            self._job = None
            if job.overdue and job.reply[0] == "error":  # it ended because it was told to, and that was why
                job.reply = self._too_late(job)
            if job.id:
                self._keep(job.id, job.reply)
            if job.link is not None:
                self._finish(job.link, job.sequence, job.reply)
            return
        allowed_s = self._command_s + self._recover_s
        if not job.overdue and now - job.began_s > allowed_s:
            job.overdue = job.halted = True
            self._tracker.halt()
            if job.link is not None:
                self._finish(job.link, job.sequence, self._too_late(job))
                job.link = None
        elif job.link is not None and now - job.beat_s > _HEARTBEAT_S:
            job.beat_s = now
            self._answer(job.link, job.sequence, ("wait", {"elapsed": f"{now - job.began_s:.1f}"}))

    def _too_late(self, job: _Job) -> Reply:
        allowed_s = self._command_s + self._recover_s
        words = f"the tracker did not finish '{job.verb}' within {allowed_s:g} s; it was told to halt"
        return "error", {"kind": "timeout", "text": words}

    def _finish(self, link: Link, sequence: int, reply: Reply) -> None:
        """Deliver what the tracker has said. The emulator spoils it here."""
        self._answer(link, sequence, reply)

    def _keep(self, id_: str, reply: Reply) -> None:
        self._kept[id_] = reply
        while len(self._kept) > _MOST_KEPT:
            self._kept.popitem(last=False)

    def forget(self) -> None:
        """Hang up on everybody and forget all results, as a restart of this computer would. For the loop's thread."""
        self._boot = secrets.token_hex(8)
        self._kept.clear()
        self._prepared_for = ""
        if self._job is not None:
            self._job.id = ""
        for link in list(self._links):
            self._drop(link, "the bridge restarts", forever=True)

    # -- the tracker's thread ------------------------------------------------------------------------------------------

    def _start_worker(self) -> None:
        self._worker = threading.Thread(target=self._serve_tracker, name="tracker", daemon=True)
        self._worker.start()

    def _worker_lives(self) -> bool:
        return self._worker is not None and self._worker.is_alive()

    def _serve_tracker(self) -> None:
        """Do one job after the other until the service closes.

        Whatever is no error of a tracker is a mistake in its driver: it ends this thread with a traceback in the log;
        who asked is told, and a new thread takes over.
        """
        while True:
            self._work.acquire()
            if self._closing.is_set():
                break
            job = self._jobs.popleft()
            try:
                reply: Reply = ("ok", self._with_tracker(job))
                wire.encode(0, *reply)  # what does not fit on a line is a mistake that must show here
            except (TrackerError, ValueError) as error:
                reply = ("error", wire.error_fields(error))
            finally:
                self._awake()
            job.reply = reply
            self._awake()
        if self._reached:
            with contextlib.suppress(TrackerError), self._lock:  # it is let go of in any case
                self._tracker.disconnect()

    def _with_tracker(self, job: _Job) -> dict[str, str]:
        """Do a job; a tracker that was lost is sought again for a while, set up as before, and asked again."""
        until_s = time.monotonic() + self._recover_s
        while True:
            if job.halted:
                raise Halted("tracker: it was told to halt; there is no measurement")
            try:
                with self._lock:
                    if not self._reached:
                        self._tracker.connect()
                        if self._settings is not None and job.verb != "prepare":
                            self._tracker.prepare(self._settings)
                        self._reached = True
                    return job.call()
            except TrackerLinkLost as error:
                self._reached = False
                if time.monotonic() >= until_s or self._closing.is_set():
                    raise
                self._complain("the tracker is sought again: %s", error)
            self._closing.wait(_RECONNECT_S)


class _SerialPump:
    """Carries bytes between a serial port and one end of a socket pair, and opens the port again when it was lost."""

    def __init__(self, url: str, baud: int, end: socket.socket) -> None:
        self._url, self._baud, self._end = url, baud, end
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="tracker bridge, serial", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        self._thread.join(_JOIN_S)
        self._end.close()

    def _run(self) -> None:
        self._end.setblocking(False)
        while not self._closing.is_set():
            try:
                with serial.serial_for_url(self._url, baudrate=self._baud, timeout=0.02, write_timeout=2.0) as port:
                    LOG.info("serving %s", self._url)
                    self._carry(port)
            except (serial.SerialException, OSError, ValueError) as error:
                LOG.warning("%s: %s; it is tried again", self._url, error)
                self._closing.wait(_REOPEN_SERIAL_S)

    def _carry(self, port: serial.SerialBase) -> None:
        while not self._closing.is_set():
            data = port.read(1)
            if data:
                data += port.read(min(port.in_waiting, _READ_AT_ONCE))
                with contextlib.suppress(BlockingIOError):  # a flood that nobody reads may be lost
                    self._end.send(data)
            with contextlib.suppress(BlockingIOError):
                waiting = self._end.recv(_READ_AT_ONCE)
                if waiting:
                    port.write(waiting)
