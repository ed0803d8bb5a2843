"""Doubts about an arm since it was connected: the first is kept, and one of each kind is reported to a listener."""

from __future__ import annotations

import threading

from drivers.arms.protocol import ArmError, DoubtListener


class FirstDoubt:
    """Keeps the first doubt and reports one of each kind. Any thread may call any method.

    A later doubt of another kind matters: the first one may be harmless, and a safety stop is not.

    Attributes
    ----------
    error : ArmError or None
        The first doubt since ``clear``; None if there is none.
    text, kind : str
        What was found, without the arm's name and the remedy; a key of ``drivers.arms.ur_answers.REFUSALS``.
    """

    def __init__(self) -> None:
        self._listener: DoubtListener = lambda error: None
        self.error: ArmError | None = None
        self.text, self.kind = "", ""
        self._noted: dict[type[ArmError], ArmError] = {}
        self._reporting = False
        self._lock = threading.Lock()

    def watch(self, listener: DoubtListener) -> None:
        """Report to ``listener`` from now on, at once what is noted already."""
        with self._lock:
            self._listener = listener
            noted = [*self._noted.values()] if self._reporting else []
        for error in noted:
            listener(error)

    def note(self, error: ArmError, text: str, kind: str = "link") -> None:
        """Keep a doubt if it is the first, and report it if it is the first of its kind and the arm is connected."""
        with self._lock:
            if type(error) in self._noted:
                return
            self._noted[type(error)] = error
            if self.error is None:
                self.error, self.text, self.kind = error, text, kind
            reporting = self._reporting
        if reporting:
            self._listener(error)

    def report(self) -> None:
        """Report doubts from now on, and those that came while the arm was being connected."""
        with self._lock:
            noted = [] if self._reporting else [*self._noted.values()]
            self._reporting = True
        for error in noted:
            self._listener(error)

    def mute(self) -> None:
        """Report no more doubts: the link is being closed."""
        with self._lock:
            self._reporting = False

    def clear(self) -> None:
        """Forget all doubts."""
        with self._lock:
            self.error, self.text, self.kind = None, "", ""
            self._noted.clear()
