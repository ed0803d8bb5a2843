"""The states of one UR arm in its worker process: which one is new, which one may be old, and when none arrives."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NoReturn

from drivers.arms.ur_control import UrControl
from drivers.arms.ur_rtde_reader import UrSample
from drivers.patience import Patience

SILENT_S = 0.3
"""The arm's state is unknown if no new one arrives for this long."""
_SILENT_LOOKS = 10
"""Smallest number of looks in that time: a process that was not scheduled has not looked."""
_STALL_S = 0.1
"""A process that has not looked at its arm for this long was not scheduled, or waited for the controller."""
_CATCH_UP_S = 0.02
"""Time in which the client reads what arrived during a stall: the first of these states are old."""
_BROKEN_BY_STALL_S = 1.0
"""A stall at least this long, and at most this long ago, explains a broken link: the client's own silence broke it."""
_ASK_AGAIN_S = 0.0005

End = Callable[[str, str], NoReturn]
"""Function that ends the process; its arguments are a kind of ``drivers.arms.ur_answers.REFUSALS`` and a sentence."""


class States:
    """States of one arm. ``end`` is called when the arm's state is unknown, ``meanwhile`` while waiting for a state."""

    def __init__(self, control: UrControl, end: End, meanwhile: Callable[[], None]) -> None:
        self._control, self._end, self._meanwhile = control, end, meanwhile
        self._looked_s = self._news_s = time.monotonic()
        self._stall_ended_s, self._stall_s = -math.inf, 0.0
        self._time_s = -1.0
        self._looks_without_news = 0

    @property
    def age_s(self) -> float:
        """Age of the newest state [s]."""
        return time.monotonic() - self._news_s

    def check_links(self) -> None:
        """End the process if a link broke: the client would reconnect by itself again and again, and finally crash."""
        if not self._control.connected:
            self.lost("the RTDE link broke")

    def lost(self, text: str) -> NoReturn:
        """End the process because the arm's state is unknown; name a long stall of this process as the cause."""
        if time.monotonic() - self._stall_ended_s < _BROKEN_BY_STALL_S:
            self._end("stalled", f"this computer was silent for {self._stall_s:.1f} s (suspended, or too busy): {text}")
        self._end("link", text)

    def newest(self) -> UrSample:
        """Return the newest state."""
        sample = self._control.sample()
        if not sample.complete:
            self.check_links()
            self.lost("the controller's state is not one of six joints")
        if not sample.finite:
            self._end("nonsense", "the controller reports positions or speeds of its joints that are no numbers")
        return sample

    def look(self) -> tuple[UrSample, bool]:
        """Return the newest state, and whether it is new; end the process if none has arrived for too long."""
        self._note_look()
        sample, now = self.newest(), time.monotonic()
        if sample.time_s != self._time_s:
            self._time_s, self._news_s, self._looks_without_news = sample.time_s, now, 0
            return sample, True
        self._looks_without_news += 1
        if now - self._news_s > SILENT_S and self._looks_without_news > _SILENT_LOOKS:
            self.lost(f"no state came for {SILENT_S:g} s")
        return sample, False

    def next(self, within_s: float = SILENT_S) -> UrSample:
        """Return the first state sent after this call; end the process if none arrives ``within_s`` [s]."""
        self._note_look()
        before = self._control.time_s
        patience = Patience(within_s)
        while True:
            if self._note_look():  # first read the states that arrived meanwhile
                time.sleep(_CATCH_UP_S)
                before = self._control.time_s
            elif self._control.time_s != before:
                return self.newest()
            self.check_links()
            if patience.over:
                self.lost(f"no state came for {within_s:g} s")
            self._meanwhile()
            time.sleep(_ASK_AGAIN_S)

    def _note_look(self) -> bool:
        """Note a look at the arm; return whether it is late, so that the newest state may be old."""
        now = time.monotonic()
        gap_s, self._looked_s = now - self._looked_s, now
        if gap_s > _BROKEN_BY_STALL_S:
            self._stall_ended_s, self._stall_s = now, gap_s
        return gap_s > _STALL_S
