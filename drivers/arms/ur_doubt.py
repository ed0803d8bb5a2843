"""The first doubt about an arm since it was connected: kept for the caller, and reported to a listener at once."""

from __future__ import annotations

import threading

from drivers.arms.protocol import ArmError, DoubtListener


class FirstDoubt:
    """Keeps and reports one doubt at a time. Any thread may call any method.

    Attributes
    ----------
    listener : callable
        Receives the doubt.
    error : ArmError or None
        The first doubt since ``clear``; None if there is none.
    text : str
        What was found, without the arm's name and the remedy.
    """

    def __init__(self) -> None:
        self.listener: DoubtListener = lambda error: None
        self.error: ArmError | None = None
        self.text = ""
        self._reporting = False
        self._lock = threading.Lock()

    def note(self, error: ArmError, text: str) -> None:
        """Keep a doubt if it is the first, and report it if the arm is connected."""
        with self._lock:
            if self.error is not None:
                return
            self.error, self.text = error, text
            reporting = self._reporting
        if reporting:
            self.listener(error)

    def report(self) -> None:
        """Report doubts from now on, and one that came while the arm was being connected."""
        with self._lock:
            reporting, self._reporting = self._reporting, True
            error = self.error
        if error is not None and not reporting:
            self.listener(error)

    def mute(self) -> None:
        """Report no more doubts: the link is being closed."""
        with self._lock:
            self._reporting = False

    def clear(self) -> None:
        """Forget the doubt."""
        with self._lock:
            self.error, self.text = None, ""
