"""A stream of joint positions that a UR arm's worker sends, one each control cycle (``servoj``).

Loads no numpy: the worker process starts faster without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.arms.path_end import slowed
from drivers.arms.ur_rtde_reader import UrSample

SLIDER_UP = 0.995
"""Smallest speed slider for a path, 100 %: a controller that scales time does not follow the positions."""
LATE_S = 0.1
"""Delay of the next position after which the stream is aborted: the arm has stood still in the middle of the path."""
_FOLLOWS_WITHIN_S = 0.3
"""Lag limit: every joint must be within ``_FOLLOWS_RAD`` of a position sent in this time. ``servoj`` lags less."""
_FOLLOWS_RAD = 0.02
_AT_GOAL_RAD = 2e-4
_ARRIVES_WITHIN_S = 1.0
"""Time for the arm to reach the last position."""


@dataclass
class Stream:
    """A stream in progress. A late position delays all later ones: none is skipped, none is sent early.

    Attributes
    ----------
    rows : sequence of joint positions [rad]
    period_s, lookahead_s, gain : float
        Arguments of ``servoj``.
    due_s : float
        When the next position must be sent, by ``time.monotonic``.
    begun_s : float
        Controller time of the state from which the stream began [s].
    sent : int
        Number of positions sent; the last one is repeated until the arm is there.
    reached : float or None
        Row of the path at which ``slow_down`` ends it; None if it was not called.
    """

    rows: Sequence[Sequence[float]]
    period_s: float
    lookahead_s: float
    gain: float
    due_s: float
    begun_s: float
    sent: int = 0
    ended_s: float | None = None
    reached: float | None = None

    @property
    def goal(self) -> Sequence[float]:
        """The position to send next."""
        return self.rows[min(self.sent, len(self.rows) - 1)]

    def note_sent(self, now: float) -> None:
        """Note that the position was sent at ``now``."""
        self.sent += 1
        self.due_s = max(self.due_s, now - self.period_s) + self.period_s
        if self.sent >= len(self.rows) and self.ended_s is None:
            self.ended_s = now

    def slow_down(self) -> None:
        """End the path early: slow down along it to rest."""
        if self.reached is None and self.ended_s is None:
            tail, self.reached = slowed(self.rows, self.sent, self.period_s)
            self.rows = [*self.rows[: self.sent], *tail]

    def arrived(self, sample: UrSample, now: float, rest_speed: float) -> bool:
        """Return whether the arm is at the last position, or has had enough time to get there."""
        if self.ended_s is None:
            return False
        there = sample.distance(self.rows[-1]) <= _AT_GOAL_RAD and sample.speed <= rest_speed
        there = there and sample.time_s - self.begun_s >= (len(self.rows) - 1) * self.period_s  # ignore old states
        return there or now - self.ended_s > _ARRIVES_WITHIN_S

    def behind(self, sample: UrSample) -> str:
        """Return why the arm does not follow, in words; empty if it follows."""
        if not self.sent:
            return ""
        last = min(self.sent, len(self.rows)) - 1
        first = max(0, last - int(_FOLLOWS_WITHIN_S / self.period_s))
        recent = self.rows[first : last + 1]
        for joint, value in enumerate(sample.q):
            low, high = min(row[joint] for row in recent), max(row[joint] for row in recent)
            if not low - _FOLLOWS_RAD <= value <= high + _FOLLOWS_RAD:
                away = max(low - value, value - high)
                return f"joint {joint + 1} was {away:.3f} rad away from the path that it was to follow"
        return ""
