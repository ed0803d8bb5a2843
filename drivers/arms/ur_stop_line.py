"""The dashboard connection over which a UR arm is stopped. It stays open and is checked all the time.

Questions and stops share it. The controller answers in order, so a stop can be sent without waiting for the answer to
an earlier question. If the line fails when it is needed, a new one is tried for a short time.
"""

from __future__ import annotations

import queue
import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, suppress

from drivers.arms.protocol import LinkLost
from drivers.arms.ur_links import DASHBOARD_PORT, Connection, Dashboard, cause, require_stopped, stop_program
from drivers.patience import SLICE_S, Patience, patient_get

_QUESTION = "running"
_ASK_EVERY_S = 0.1
_SILENT_S = 0.35
"""A dashboard that leaves a question unanswered for this long is lost."""
_ANSWER_WITHIN_S = 0.04
"""Time to wait for an open dashboard to answer a stop; after it a new connection is tried."""
_RETRY_WITHIN_S = 0.25
_OPEN_WITHIN_S = 0.25
_AGAIN_S = 0.05
_TRIES = 2
"""A dashboard is lost if it closed its connection and this many attempts to open it again failed."""
_END_WITHIN_S = 1.0
_MOST_BYTES = 4096


class _Line:
    """One open connection. One thread calls ``pump`` and then ``close``; any thread may call the other methods."""

    def __init__(self, host: str, port: int, patience: Patience) -> None:
        """Connect and read the greeting. Raises ``LinkLost``."""
        with ExitStack() as unfinished:
            self._link = unfinished.enter_context(Connection.to(host, port, patience))
            Dashboard(self._link, patience)
            self._link.keep_alive()
            unfinished.pop_all()
        self._sending = threading.Lock()
        self._waiting: deque[queue.SimpleQueue[str | None]] = deque()
        self._received = bytearray()
        self._ended = False

    def send(self, text: str) -> queue.SimpleQueue[str | None]:
        """Send a line and return the queue for its answer; the answer is None if the connection has ended."""
        answer: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        with self._sending:
            self._waiting.append(answer)
            try:
                if not self._ended:
                    self._link.send_at_once(f"{text}\n".encode("ascii"))
            except OSError:
                self._ended = True
            if self._ended:
                answer.put(None)
        return answer

    def ask(self, text: str, patience: Patience) -> str:
        """Send a line and return its answer. Raises ``LinkLost``."""
        try:
            answer = patient_get(self.send(text), patience)
        except queue.Empty:
            raise LinkLost(f"{self._link.where}: the dashboard did not answer '{text}' in time") from None
        if answer is None:
            raise LinkLost(f"{self._link.where}: the controller closed the dashboard's connection")
        return answer

    @property
    def ended(self) -> bool:
        """Whether the connection has ended."""
        return self._ended

    @property
    def where(self) -> str:
        """Host and port."""
        return self._link.where

    def pump(self, patience: Patience) -> None:
        """Wait for bytes and pass complete lines to those who asked; detect the end of the connection."""
        try:
            more = self._link.receive(patience)
        except OSError:
            more = b""
        if more is None:
            return
        self._received += more
        while (end := self._received.find(b"\n")) >= 0:
            line = self._received[:end].decode("utf-8", errors="replace").strip()
            del self._received[: end + 1]
            with self._sending:
                if not self._waiting:  # a line that nobody asked for: the peer is no dashboard any more
                    more = b""
                    break
                self._waiting.popleft().put(line)
        if not more or len(self._received) > _MOST_BYTES:
            self.end()

    def end(self) -> None:
        """End the connection; pending questions get the answer None."""
        with self._sending:
            self._ended = True
            while self._waiting:
                self._waiting.popleft().put(None)
            self._link.shut_down()

    def close(self) -> None:
        """End the connection and free its socket."""
        self.end()
        self._link.close()


class StopLine:
    """Stops the program of one controller. Any thread may call any method.

    A thread of this object calls ``lost`` when the controller no longer answers: within 0.2 s if it closed the
    connection and refuses a new one, within 0.6 s if it is silent.
    """

    def __init__(self, host: str, lost: Callable[[str], object], *, port: int = DASHBOARD_PORT) -> None:
        self._host, self._lost, self._port = host, lost, port
        self._opening = threading.Lock()
        self._line: _Line | None = None
        self._closing = threading.Event()
        self._keeper: threading.Thread | None = None

    def open(self, look: Callable[[], None] = lambda: None) -> None:
        """Open a new connection and keep it; ``look`` is called during waits and may raise. Raises ``LinkLost``."""
        self.close()
        self._closing = threading.Event()
        self._reopened(Patience(_OPEN_WITHIN_S, look=look))
        self._keeper = threading.Thread(
            target=self._keep, args=(self._closing,), name=f"dashboard of {self._host}", daemon=True
        )
        self._keeper.start()

    def _reopened(self, patience: Patience) -> _Line:
        """Return the open connection, or a new one if it has ended. Raises ``LinkLost``."""
        if not self._opening.acquire(timeout=_OPEN_WITHIN_S):
            raise LinkLost(f"{self._host}:{self._port}: no connection to the UR dashboard in time")
        try:
            line = self._line
            if line is None or line.ended:
                line = self._line = _Line(self._host, self._port, patience)
            return line
        finally:
            self._opening.release()

    def confirm(self, patience: Patience) -> None:
        """Ask a question that changes nothing; if the connection was closed, ask once more on a new one.

        Raises
        ------
        LinkLost
            If it was not answered.
        """
        line = self._reopened(patience)
        try:
            line.ask(_QUESTION, patience)
        except LinkLost:
            if not line.ended:
                raise
            self._reopened(patience).ask(_QUESTION, patience)

    def stop(self) -> None:
        """Stop the program with one line and wait for its answer; if the open connection fails, use a new one.

        Raises
        ------
        LinkLost
            If the controller did not confirm the stop; the message says if its pendant is in local control.
        """
        line, patience = self._line, Patience(_ANSWER_WITHIN_S)
        if line is not None and not line.ended:
            with suppress(LinkLost):
                return require_stopped(lambda text: line.ask(text, patience), self._host)
        stop_program(self._host, _RETRY_WITHIN_S, port=self._port)

    def close(self) -> None:
        """Close the connection; harmless when closed."""
        self._closing.set()
        keeper, self._keeper = self._keeper, None
        line, self._line = self._line, None
        if line is not None:
            line.end()
        if keeper is not None and keeper is not threading.current_thread():
            keeper.join(_END_WITHIN_S)
        if line is not None:
            line.close()

    # -- the thread that keeps it -------------------------------------------------------------------------------------

    def _keep(self, closing: threading.Event) -> None:
        failures = 0
        while not closing.is_set():
            try:
                self._watch(self._reopened(Patience(_OPEN_WITHIN_S)), closing)
                failures = 0
                continue
            except LinkLost as error:
                why = cause(error)
            failures += 1
            if failures >= _TRIES and not closing.is_set():
                self._lost(why)
            closing.wait(_AGAIN_S)

    def _watch(self, line: _Line, closing: threading.Event) -> None:
        """Repeat the question until the connection ends. Report and end a silent connection.

        Raises ``LinkLost`` if it ended before any answer.
        """
        until_next, silence, answers = Patience(_ASK_EVERY_S), Patience(_SILENT_S), 0
        question: queue.SimpleQueue[str | None] | None = line.send(_QUESTION)
        while not (line.ended or closing.is_set()):
            line.pump(Patience(SLICE_S))
            if question is not None and not question.empty():
                question, until_next, answers = None, Patience(_ASK_EVERY_S), answers + (not line.ended)
            elif question is None and until_next.left_s < SLICE_S:
                question, silence = line.send(_QUESTION), Patience(_SILENT_S)
            elif question is not None and silence.over:
                line.end()
                self._lost(f"{line.where}: it left a question unanswered for {_SILENT_S:g} s")
        line.close()
        if not (answers or closing.is_set()):
            raise LinkLost(f"{line.where}: the controller closed the connection at once")
