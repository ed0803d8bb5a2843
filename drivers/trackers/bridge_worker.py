"""The only thread that calls the tracker behind a bridge: one command at a time, reconnecting after a lost link."""

from __future__ import annotations

import contextlib
import logging
import queue
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

from drivers.trackers import bridge_wire as wire
from drivers.trackers.bridge_links import JOIN_S, RateLimitedLog
from drivers.trackers.bridge_wire import Fields
from drivers.trackers.protocol import Halted, Preparation, Tracker, TrackerError, TrackerLinkLost

LOG = logging.getLogger(__name__)

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
