"""Doubts about an arm since ``connect``: the first is stored, and the first of each kind is reported to a listener."""

from __future__ import annotations

import threading

from drivers.arms.protocol import ArmError, DoubtListener


class FirstDoubt:
    """Store of the first doubt; reports the first of each kind. Any thread may call any method.

    A later doubt of another kind matters: the first may be harmless, but a safety stop is not.

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
        """Report to ``listener`` from now on; report doubts that are already noted at once."""
        with self._lock:
            self._listener = listener
            noted = [*self._noted.values()] if self._reporting else []
        for error in noted:
            listener(error)

    def note(self, error: ArmError, text: str, kind: str = "link") -> None:
        """Store a doubt if it is the first; report it if it is the first of its kind and the arm is connected."""
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
        """Report doubts from now on, and also those noted during ``connect``."""
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
