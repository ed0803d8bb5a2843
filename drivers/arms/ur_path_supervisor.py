"""The supervisor of a UR arm's worker, extended to follow paths: it also sends a stream of positions.

During a stream its positions keep the controller's watchdog from expiring; a kick would interrupt the stream.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from drivers.arms.path_end import slowed
from drivers.arms.ur_control import Refusal, UrControl, advised, failed
from drivers.arms.ur_motion import Motion, RestCriterion
from drivers.arms.ur_rtde_reader import UrSample
from drivers.arms.ur_supervisor import AT_GOAL_RAD, Application, Supervisor


class PathSupervisor(Supervisor):
    """Supervisor that also streams, see ``Supervisor``; ``stream`` must be called when ``patience_s`` has passed."""

    def __init__(self, application: Application, control: UrControl, watchdog_hz: float, rest: RestCriterion) -> None:
        super().__init__(application, control, watchdog_hz, rest)
        self._stream: Stream | None = None  # the last stream; it is in progress while ``_streams``
        self._streamed: Motion | None = None  # the motion of that stream

    def path(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Begin to stream joint positions; ``stream`` sends them."""
        sample = self._require_movable()
        rows = request["q"]
        if sample.speed_fraction is not None and sample.speed_fraction < SLIDER_UP:
            raise advised(
                f"the speed slider is at {sample.speed_fraction:.0%}, a path needs 100 %; set it so on the pendant"
            )
        if sample.distance(rows[0]) > AT_GOAL_RAD:
            raise advised("it is not at the beginning of the path; move there first")
        self._ensure_program_runs(sample)
        self._require_not_braked()
        now = time.monotonic()
        self._resting_since, self._cut_short = None, False
        self._unrest.begin()
        self._stream = Stream(rows, request["period_s"], request["lookahead_s"], request["gain"], now, sample.time_s)
        self._motion = self._streamed = Motion(rows[-1], -1, self._now())
        return {}

    def reached(self) -> dict[str, Any]:
        """Return the row at which the last path was ended early; empty if it was not."""
        reached = None if self._stream is None else self._stream.reached
        return {} if reached is None else {"reached": reached}

    def end_path(self) -> dict[str, Any]:
        """Slow down along the path and rest on it; harmless when no path is being followed."""
        stream = self._stream
        if stream is not None and self._streams and not self._application.braked:
            stream.slow_down()
            if self._streamed is not None:
                self._streamed.goal = stream.rows[-1]
        return {}

    @property
    def _streams(self) -> bool:
        motion = self._motion
        return motion is not None and motion is self._streamed and motion.running and not self._halted

    @property
    def patience_s(self) -> float:
        """Time until the next position of a stream is due [s]; infinite if there is no stream."""
        if self._stream is None or not self._streams:
            return math.inf
        return max(self._stream.due_s - time.monotonic(), 0.0)

    def stream(self) -> None:
        """Send the position that is due, if any; end the stream after a brake, a fault or a delay of the computer."""
        stream, now = self._stream, time.monotonic()
        if stream is None or not self._streams or self._application.braked or now < stream.due_s:
            return
        late_s = now - stream.due_s
        if stream.sent and late_s > LATE_S:
            text = (
                f"this computer was late by {late_s:.2f} s with the next position of the path, so the arm was stopped"
            )
            self._control.brake()
            self._record_fault(Refusal("stalled", text))
            return
        try:
            accepted = self._control.servo(stream.goal, stream.period_s, stream.lookahead_s, stream.gain)
        except Refusal as refusal:  # its link may just have broken, or its arm have stopped
            self._streamed = None
            with suppress(Refusal):
                self._require_ready(self._states.next())
                self._record_fault(refusal)
            return
        if self._application.braked:  # the brake may have come before the position was sent
            self.take_brake()
            self._stop_program()
        elif not accepted:
            self._states.check_links()
            self._not_streamed()
        else:
            self._kicks.kicked(now)
            stream.note_sent(now)

    def _not_streamed(self) -> None:
        """Record why the control program did not accept a position."""
        self._streamed = None  # send no further position while the reason is determined
        try:
            self._require_ready(self._states.next())
        except Refusal:
            return  # recorded
        self._not_served(failed("the control program did not take a position of the path"))

    def _meanwhile(self) -> None:
        super()._meanwhile()
        self.stream()

    def _track_motion(self, motion: Motion, sample: UrSample, now: float, news: bool) -> None:
        """End a stream whose arm has arrived; record a fault if the arm does not follow or its slider was moved."""
        stream = self._stream
        if stream is None or not self._streams:
            super()._track_motion(motion, sample, now, news)
            return
        if not news or self._application.braked:
            return
        behind = stream.behind(sample)
        problem = failed(behind) if behind else None
        if sample.speed_fraction is not None and sample.speed_fraction < SLIDER_UP:
            text = "its speed slider was moved while it followed a path; set it to 100 %, then connect again"
            problem = advised(text)
        if problem is not None:
            self._control.brake()
            self._record_fault(problem)
        elif stream.arrived(sample, time.monotonic(), self._rest.speed):
            self._end_motion(motion, now)
            if not self._control.end_servo() and not self._application.braked:
                self._not_streamed()


# -- A stream of joint positions that a UR arm's worker sends, one each control cycle (``servoj``) --------------------
#
# Loads no numpy: the worker process starts faster without it.


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
