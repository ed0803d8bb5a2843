"""Stops of a UR arm: a dashboard connection that is kept open for them, and the latch that keeps the arm stopped.

The connection is checked while it is not needed. If it fails when it is needed, a new one is tried, for a short time.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from drivers.arms.protocol import LinkLost
from drivers.arms.ur_links import DASHBOARD_PORT, Connection, Dashboard, require_stopped, stop_program

_ANSWER_WITHIN_S = 0.04
"""An open dashboard that does not answer within this time is not waited for: a new connection is tried."""
_RETRY_WITHIN_S = 0.25
_OPEN_WITHIN_S = 0.25
_CHECK_EVERY_S = 0.5
_TRIES = 3
"""A dashboard that could not be opened again this often, ``_CHECK_EVERY_S`` apart, is lost."""


class StopLatch:
    """Counts brakes, and stops that are under way. Any thread may call any method.

    Attributes
    ----------
    brakes : int
        Number of brakes so far.
    stops : int
        Stops that are being commanded or waited for: a program that is started meanwhile would be stopped by them.
    """

    def __init__(self) -> None:
        self.brakes = 0
        self.stops = 0
        self._released = 0
        self._changed = threading.Condition()

    @property
    def in_force(self) -> bool:
        """Whether there was a brake that has not been released."""
        return self.brakes > self._released

    def refuse(self) -> None:
        """Count a brake that is only about to be commanded."""
        with self._changed:
            self.brakes += 1
            self._changed.notify_all()

    @contextmanager
    def stopping(self, brakes: int = 0) -> Iterator[None]:
        """Count a stop that is under way, and a brake."""
        with self._changed:
            self.brakes += brakes
            self.stops += 1
        try:
            yield
        finally:
            with self._changed:
                self.stops -= 1
                self._changed.notify_all()

    def wait_for_stops(self, timeout_s: float) -> None:
        """Wait until no stop is under way."""
        with self._changed:
            self._changed.wait_for(lambda: not self.stops, timeout_s)

    def release(self, brakes: int) -> None:
        """Release all brakes up to number ``brakes``."""
        with self._changed:
            self._released = max(self._released, brakes)


class StopLine:
    """Stops the program of one controller. Any thread may call any method."""

    def __init__(self, host: str, *, port: int = DASHBOARD_PORT) -> None:
        self._host, self._port = host, port
        self._lock = threading.Lock()
        self._link: Connection | None = None
        self._dashboard: Dashboard | None = None
        self._failures = 0
        self._checked_s = 0.0

    def open(self) -> None:
        """Open the connection, if it is not open. Raises ``LinkLost``."""
        with self._lock:
            if self._dashboard is None:
                self._open()

    def _open(self) -> None:
        deadline = time.monotonic() + _OPEN_WITHIN_S
        link = Connection.to(self._host, self._port, deadline)
        try:
            self._dashboard = Dashboard(link, deadline)
        except LinkLost:
            link.close()
            raise
        link.keep_alive()
        self._link = link

    def stop(self) -> None:
        """Stop the program: one line and its answer, on a new connection if the open one fails.

        Raises
        ------
        LinkLost
            If the controller did not confirm the stop; the message says if its pendant is in local control.
        """
        if self._lock.acquire(timeout=_ANSWER_WITHIN_S):  # another stop holds it at most for its own answer
            try:
                if self._dashboard is not None and self._stopped_by(self._dashboard):
                    return
            finally:
                self._lock.release()
        stop_program(self._host, _RETRY_WITHIN_S, port=self._port)

    def _stopped_by(self, dashboard: Dashboard) -> bool:
        """Send the line; return whether the stop was confirmed, and close a connection that did not confirm it."""
        dashboard.deadline = time.monotonic() + _ANSWER_WITHIN_S
        try:
            require_stopped(dashboard, self._host)
        except LinkLost:  # an answer may still come: it must not be taken for that to a later stop
            self._close()
            return False
        return True

    def check(self) -> str:
        """Open the connection again if the controller closed it; return why it is lost, empty if it is not.

        Looks every half second and takes a quarter of a second at most.
        """
        now = time.monotonic()
        if now - self._checked_s < _CHECK_EVERY_S or not self._lock.acquire(blocking=False):
            return ""
        try:
            self._checked_s = now
            if self._link is not None and self._link.closed_by_peer():
                self._close()
            if self._dashboard is None:
                self._open()
            self._failures = 0
        except LinkLost as error:
            self._failures += 1
            return str(error) if self._failures == _TRIES else ""
        finally:
            self._lock.release()
        return ""

    def close(self) -> None:
        """Close the connection; harmless when closed."""
        with self._lock:
            self._close()

    def _close(self) -> None:
        link, self._link, self._dashboard = self._link, None, None
        if link is not None:
            with suppress(OSError):
                link.close()
