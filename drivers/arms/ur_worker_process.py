"""The worker process of a UR arm as seen by the application: requests, answers, heartbeats, faults, and its end."""

from __future__ import annotations

import json
import math
import os
import queue
import select
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drivers
from drivers.arms.protocol import LiveArm
from drivers.arms.ur_control import Refusal
from drivers.arms.ur_links import printable
from drivers.arms.ur_motion import DECELERATES_WITHIN_S
from drivers.patience import Patience, patient_get

_BEAT_EVERY_S = 0.05
_WORKER = "drivers.arms.ur_worker"
"""Module that is run as the worker."""
_SILENT_S = 0.3
"""The arm's state is unknown if its worker sends no heartbeat for this long."""
_SILENT_LOOKS = 4
"""Smallest number of looks of this process in that time: a process that was not scheduled has not read either."""
_LOCK_WITHIN_S = 0.01
"""Time to wait for the lock. Messages are short and read at once, so a longer wait means that the worker hangs."""
_LOCK_AT_ONCE_S = 0.002
_MOTIONS = ("move", "path")
_RELEASES = ("release", "restart")
_STOPPED: Mapping[str, Any] = {"error": "stopped", "text": "its motion was stopped before the goal"}

_LAST_LINES, _LONGEST_LINE = 60, 400
"""Number and length of the lines that are kept of the worker's standard error."""
_ENDING_WITHIN_S = 0.1
_LAST_WORDS_WITHIN_S = 0.02
"""Time limit for exit code and last words of a process that ended: the other arms wait for it."""

FaultReport = Callable[[str, str], object]
"""Callback for a fault, with the kind of a refusal and a sentence; called from any thread, returns at once."""


def last_words(lines: Iterable[bytes]) -> str:
    """Return the last output of a process that ended, after ``: ``; empty if it wrote nothing.

    For an exception this is its last line; for a dump of all threads its first line and where the main thread was.
    """
    texts = [
        text for line in lines if (text := printable(line.decode("utf-8", errors="replace").strip(), _LONGEST_LINE))
    ]
    if not texts:
        return ""
    dumps = [k for k, text in enumerate(texts) if text.startswith(("Timeout (", "Fatal Python error"))]
    if not dumps:
        return f": {texts[-1]}"
    where = next((k for k in range(len(texts) - 1, dumps[-1], -1) if "(most recent call first)" in texts[k]), None)
    return f": {texts[dumps[-1]]}" + ("" if where is None else f" {' '.join(texts[where + 1 : where + 3])}")


_CRASHES = ("SIGABRT", "SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL")
_WHAT = b"what():"
"""In front of the reason that the RTDE client's own language gives for a crash."""


def ending(code: int | None, lines: Iterable[bytes]) -> WorkerGone:
    """Return why a process ended, by its exit code, if that is known, and the lines that it wrote last."""
    kept = list(lines)
    if code is None:
        return WorkerGone("its driver process ended", "ended")
    if -code not in [getattr(signal, name, 0) for name in _CRASHES]:
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return WorkerGone(f"its driver process ended ({how}{last_words(kept)})", "ended")
    said = next((line.partition(_WHAT)[2] for line in kept if _WHAT in line), b"")
    what = f": {printable(said.decode(errors='replace').strip(), _LONGEST_LINE)}" if said else last_words(kept)
    return WorkerGone(
        f"its RTDE client crashed (signal {-code}{what}); possible: a malformed packet came, or the link broke", "link"
    )


class WorkerGone(Exception):
    """The worker process has ended, or did not answer in time; the message is the reason.

    Attributes
    ----------
    kind : str
        A key of ``drivers.arms.ur_supervised_link.REFUSALS``.
    """

    def __init__(self, reason: str, kind: str = "driver") -> None:
        super().__init__(reason)
        self.kind = kind


@dataclass(frozen=True)
class HeartbeatGaps:
    """How regularly this computer kept a controller's watchdog from expiring.

    Attributes
    ----------
    longest_s : float
        Longest silence [s].
    late : int
        Number of silences longer than half the watchdog's period.
    """

    longest_s: float = 0.0
    late: int = 0

    def joined(self, other: HeartbeatGaps) -> HeartbeatGaps:
        """Return the gaps of both."""
        return HeartbeatGaps(max(self.longest_s, other.longest_s), self.late + other.late)


@dataclass(frozen=True)
class _Pending:
    """A request that waits for its answer."""

    request: str
    answered: queue.SimpleQueue[Mapping[str, Any] | None]


class WorkerProcess:
    """A worker process. Several threads may call its methods.

    ``report`` is called when the worker reports a fault, falls silent or ends, unless it was asked to end. ``opens``
    is called with True when it may start a program on the controller, with False when that was seen to run.
    """

    def __init__(self, name: str, report: FaultReport, opens: Callable[[bool], None]) -> None:
        root = str(Path(drivers.__file__).parents[1])
        paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
        self._process = subprocess.Popen(
            [sys.executable, "-m", _WORKER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            start_new_session=True,  # a Ctrl-C in the terminal must not reach the worker
            creationflags=getattr(subprocess, "HIGH_PRIORITY_CLASS", 0),  # Windows; elsewhere it raises its own
        )
        self._report_fault, self._opens = report, opens
        self._lock = threading.Lock()
        self._number = 0
        self._pending: dict[int, _Pending] = {}
        self._hello: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._ended: WorkerGone | None = None
        self._motion_asked = self._served = 0
        self._told = False  # whether it was told to brake since the last request that releases
        self._ending = threading.Event()
        self._decelerating = threading.Event()
        self._gaps = HeartbeatGaps()
        self._live = (math.inf, True, 0.0)
        self._beat_s = self._waits_until_s = 0.0
        self._looks = 0
        self._last_words: deque[bytes] = deque(maxlen=_LAST_LINES)
        self._listener = threading.Thread(target=self._listen, name=f"errors of {name}", daemon=True)
        self._listener.start()
        self._reader = threading.Thread(target=self._read, name=f"UR worker of {name}", daemon=True)
        self._reader.start()
        self._heart = threading.Thread(target=self._beat, name=f"heartbeat of {name}", daemon=True)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        """Whether the process has ended."""
        return self._ended is not None

    @property
    def gaps(self) -> HeartbeatGaps:
        """How regularly it kicked the controller's watchdog."""
        return self._gaps

    @property
    def live(self) -> LiveArm:
        """The arm as of the newest heartbeat; a motion requested since then may have begun."""
        age_s, moving, since_s = self._live
        return LiveArm(age_s + time.monotonic() - since_s, moving or self._motion_asked > self._served)

    def wait_hello(self, timeout_s: float) -> None:
        """Wait until the process serves requests. Raises ``WorkerGone``."""
        try:
            patient_get(self._hello, Patience(timeout_s))
        except queue.Empty:
            raise WorkerGone(f"its driver process did not start within {timeout_s:g} s") from None
        self._require_running()

    def _require_running(self) -> None:
        ended = self._ended
        if ended is not None:
            raise WorkerGone(str(ended), ended.kind)

    def watch(self) -> None:
        """Exchange heartbeats from now on; call it when the worker looks at its arm."""
        self._seen()
        self._heart.start()

    def call(
        self, request: str, within_s: float, permitted: Callable[[], None] = lambda: None, **arguments: Any
    ) -> dict[str, Any]:
        """Send a request and return its answer.

        ``permitted`` is called when no brake can come between it and the sending; it raises to send nothing. A call of
        ``settled`` also ends when ``brake`` is called. Raises ``WorkerGone`` or ``Refusal``.
        """
        answered: queue.SimpleQueue[Mapping[str, Any] | None] = queue.SimpleQueue()
        with self._lock:
            self._require_running()
            permitted()
            self._number += 1
            number = self._number
            self._pending[number] = _Pending(request, answered)
            if request in _MOTIONS:
                self._motion_asked = number
            if request in _RELEASES:
                self._told = False
            try:
                self._write({"id": number, "do": request, **arguments})
                problem = ""
            except OSError as error:
                problem = str(error)
        if problem:
            self._reader.join(_ENDING_WITHIN_S)  # a process that has just ended: why is read there
            self._require_running()
            raise WorkerGone(f"its driver process accepts no requests ({problem})")
        try:
            answer = patient_get(answered, Patience(within_s))
        except queue.Empty:
            raise self._silent(f"did not answer '{request}' within {within_s:.1f} s") from None
        finally:
            with self._lock:
                self._pending.pop(number, None)
        if answer is None:
            self._require_running()
        assert answer is not None
        if "error" in answer:
            raise Refusal(str(answer["error"]), str(answer["text"]))
        return dict(answer["ok"])

    def brake(self, within_s: float = _LOCK_WITHIN_S) -> bool:
        """Tell the worker to stop its arm and to begin no motion until a request ``release`` or ``restart``.

        A worker that was told by ``tell_at_once`` is not told again. Wait a few milliseconds for the motion to
        decelerate. Return True if the message was sent or no worker is left, False if another message blocked it for
        ``within_s``.
        """
        if self.has_ended:
            return True
        if not self._told and not self._tell(within_s):
            return False
        self._decelerating.wait(DECELERATES_WITHIN_S)
        return True

    def tell_at_once(self) -> None:
        """Send the worker the message of ``brake``, even if it was sent before, but only if that needs no waiting.

        It saves the start of a thread, which takes 0.1 s and more beside busy processes.
        """
        if not self.has_ended:
            self._tell(_LOCK_AT_ONCE_S, at_once=True)

    def _tell(self, within_s: float, *, at_once: bool = False) -> bool:
        """Send the brake message; return whether it was sent. ``at_once``: skip a worker that does not read."""
        if not self._lock.acquire(timeout=within_s):
            return False
        try:
            if at_once and not self._takes_messages():
                return False
            self._decelerating.clear()
            with suppress(OSError):
                self._write({"brake": True})
            self._told = True
            waiting = [one for one in self._pending.values() if one.request == "settled"]
        finally:
            self._lock.release()
        for one in waiting:
            one.answered.put(_STOPPED)
        return True

    def kill_at_once(self) -> None:
        """Kill the process without waiting for its end, which is reported as a fault."""
        self._process.kill()

    def abandon(self) -> None:
        """Kill the process without waiting for its end, which is not a fault; pending requests get no answer."""
        self._ending.set()
        self._process.kill()

    def kill(self) -> None:
        """Kill the process; harmless when it has ended."""
        self._ending.set()
        self._process.kill()
        self._join()

    def end(self, timeout_s: float) -> None:
        """Let the process stop the program and end by itself; kill it after the time limit."""
        self._ending.set()
        with self._lock, suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)
        self.kill()

    def _join(self) -> None:
        self._process.wait()
        self._reader.join()
        self._listener.join()
        if self._heart.is_alive() and self._heart is not threading.current_thread():
            self._heart.join()
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            assert pipe is not None
            with suppress(OSError):
                pipe.close()

    # -- threads -------------------------------------------------------------------------------------------------------

    def _write(self, message: Mapping[str, Any]) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(message).encode("ascii") + b"\n")
            self._process.stdin.flush()
        except ValueError as error:  # closed by ``end`` in another thread
            raise OSError(str(error)) from error

    def _takes_messages(self) -> bool:
        """Whether a short message can be written without waiting; always False on Windows, which does not tell."""
        if sys.platform == "win32" or self._process.stdin is None or self._process.stdin.closed:
            return False
        ready = select.poll()
        ready.register(self._process.stdin, select.POLLOUT)
        return bool(ready.poll(0))

    def _seen(self) -> None:
        self._beat_s, self._looks = time.monotonic(), 0

    def _beat(self) -> None:
        """Send heartbeats and check those of the worker, until it ends."""
        silent = False
        while not self._ending.wait(_BEAT_EVERY_S) and not self.has_ended:
            with self._lock, suppress(OSError):
                self._write({"beat": True})
            self._looks += 1
            if not silent and time.monotonic() - self._beat_s > _SILENT_S and self._looks > _SILENT_LOOKS:
                silent = True
                fault = self._silent(f"was silent for {_SILENT_S:g} s")
                self._report_fault(fault.kind, str(fault))

    def _silent(self, how: str) -> WorkerGone:
        """Return the fault about a worker that is silent; it may have told that it waits for its controller."""
        if time.monotonic() < self._waits_until_s:
            return WorkerGone(
                f"its controller has not answered a command for {_SILENT_S:g} s: it hangs, or the network is late",
                "link",
            )
        return WorkerGone(f"its driver process {how}")

    def _listen(self) -> None:
        """Keep the last lines of the worker's standard error."""
        assert self._process.stderr is not None
        while line := self._process.stderr.readline(_LONGEST_LINE):
            self._last_words.append(line)

    def _read(self) -> None:
        reason: WorkerGone | None = None
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if not line.endswith(b"\n"):  # the process ended in the middle of a line
                break
            message = json.loads(line)
            if "waits" in message:
                self._waits_until_s = time.monotonic() + _SILENT_S
                continue
            self._seen()
            if "beat" in message:
                longest_s, late, age_s, moving, served = message["beat"]
                self._gaps, self._live = HeartbeatGaps(longest_s, late), (age_s, moving, time.monotonic())
                self._served = served
            elif "fault" in message:
                self._report(str(message["fault"]), str(message["text"]))
            elif "decelerating" in message:
                self._decelerating.set()
            elif "lost" in message:
                reason = WorkerGone(str(message["lost"]), str(message["kind"]))
            elif "opening" in message:
                self._opens(bool(message["opening"]))
            elif "hello" in message:
                self._hello.put(None)
            else:
                with self._lock:
                    pending = self._pending.get(int(message["id"]))
                if pending is not None:
                    pending.answered.put(message)
        if reason is None:  # it has ended, and its last words came before: waiting for them takes a millisecond
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_LAST_WORDS_WITHIN_S)
            self._listener.join(_LAST_WORDS_WITHIN_S)
            reason = ending(self._process.poll(), self._last_words)
            self._report(reason.kind, str(reason))
        self._process.wait()
        with self._lock:
            self._ended = reason
            for pending in self._pending.values():
                pending.answered.put(None)
        self._hello.put(None)

    def _report(self, kind: str, text: str) -> None:
        if not self._ending.is_set():
            self._report_fault(kind, text)
