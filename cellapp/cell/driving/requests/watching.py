"""Serve those who watch a job: each has a thread and a bounded queue of its own, and never delays the job."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator

from cellapp.cell.driving.requests.job_stream import Answer, Ending, Heartbeat, Line, encode
from cellapp.ground.asking import LONGEST_LINE, WATCH
from cellapp.ground.control import JobControl
from cellapp.ground.progress import Progress

MOST_WATCHERS = 8
_MOST_WAITING = 2000
"""Length of a watcher's event queue; a slow watcher loses the oldest events. The run file has all."""
_MOST_ANSWERS = 50
_BEAT_S = 0.2
_FAREWELL_S = 0.5
"""Longest delay [s] of a job's end until all watchers have been told."""

AnswerTo = Callable[[str], Answer]
"""Callback that carries out a request and returns the answer."""


class Watchers:
    """Sends the events of a job to everybody who watches it.

    Parameters
    ----------
    name : str
        What the job does, as one word.
    control : JobControl
        Its state is part of each heartbeat.
    """

    def __init__(self, name: str, control: JobControl) -> None:
        self._name, self._control = name, control
        self._lock = threading.Lock()
        self._recent: dict[tuple[object, ...], Progress] = {}
        self._watchers: list[_Watcher] = []
        self._ending: Ending | None = None

    def publish(self, event: Progress) -> None:
        """Queue an event for all watchers. This takes microseconds, however slow they are."""
        detail = event.detail
        kind = (event.job, type(detail), getattr(detail, "arm", None))
        with self._lock:
            self._recent.pop(kind, None)  # keep insertion order: the newest is the last one
            self._recent[kind] = event
            for watcher in self._watchers:
                watcher.tell(event)

    def serve(self, connection: socket.socket, answer: AnswerTo) -> None:
        """Write events to a connection and carry out requests from it until either side ends."""
        watcher = _Watcher(connection, self._beat)
        with self._lock:
            refused = len(self._watchers) >= MOST_WATCHERS
            if not refused:
                self._watchers.append(watcher)
                for event in self._recent.values():
                    watcher.tell(event)
                if self._ending is not None:
                    watcher.dismiss(self._ending)
        if refused:
            text = f"{MOST_WATCHERS} programs watch this job already; close one of them"
            connection.sendall(encode(Answer(WATCH, False, text)))
            return
        try:
            watcher.serve(answer)
        finally:
            with self._lock:
                self._watchers.remove(watcher)

    def end(self, ending: Ending) -> None:
        """Tell all watchers how the job ended; return after ``_FAREWELL_S`` at the latest."""
        with self._lock:
            self._ending, present = ending, tuple(self._watchers)
        until_s = time.monotonic() + _FAREWELL_S
        for watcher in present:
            watcher.dismiss(ending)
        for watcher in present:
            watcher.gone.wait(max(until_s - time.monotonic(), 0.0))

    def _beat(self) -> Heartbeat:
        control = self._control
        return Heartbeat(
            self._name, control.request, control.holds, control.has_brakes, control.cancelled, control.live()
        )


class _Watcher:
    """One connection: its own thread writes, the thread that serves it reads."""

    def __init__(self, connection: socket.socket, beat: Callable[[], Heartbeat]) -> None:
        self._connection, self._beat = connection, beat
        self._events: deque[Line] = deque(maxlen=_MOST_WAITING)
        self._answers: deque[Line] = deque(maxlen=_MOST_ANSWERS)
        self._ending: Ending | None = None
        self._news = threading.Event()
        self._over = threading.Event()
        self.gone = threading.Event()

    def tell(self, event: Progress) -> None:
        """Queue an event."""
        self._events.append(event)
        self._news.set()

    def dismiss(self, ending: Ending) -> None:
        """Write the queued events, then ``ending`` as the last line."""
        self._ending = ending
        self._news.set()

    def serve(self, answer: AnswerTo) -> None:
        """Read requests until the connection or the job ends."""
        writer = threading.Thread(target=self._write, name="watcher", daemon=True)
        writer.start()
        try:
            for request in self._requests():
                self._answers.append(answer(request))
                self._news.set()
        finally:
            self._over.set()
            self._news.set()
            writer.join()

    def _requests(self) -> Iterator[str]:
        """Yield the lines from the connection until it ends; a line that is too long ends it."""
        begun = b""
        with contextlib.suppress(OSError):
            while not self._over.is_set() and len(begun) < LONGEST_LINE:
                try:
                    data = self._connection.recv(LONGEST_LINE)
                except TimeoutError:
                    continue  # a watcher need not send requests
                if not data:
                    return
                *lines, begun = (begun + data).split(b"\n")
                yield from (line.decode("utf-8", "replace").strip() for line in lines)

    def _write(self) -> None:
        with contextlib.suppress(OSError):  # the watcher has gone, or it has not read for longer than the timeout
            while not self._over.is_set():
                self._connection.sendall(b"".join(map(encode, self._lines())))
                if self._ending is not None and not self._events:
                    self._connection.sendall(encode(self._ending))
                    break
                self._news.wait(_BEAT_S)
                self._news.clear()
        self._over.set()
        self.gone.set()
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)  # wake up the reading thread

    def _lines(self) -> list[Line]:
        """Return the queued lines: answers first, then the state that results from them, then events."""
        answers = [self._answers.popleft() for _ in range(len(self._answers))]
        return [*answers, self._beat(), *(self._events.popleft() for _ in range(len(self._events)))]
