"""What really happened in a simulated campaign, recorded at the devices and not by the engine that is judged."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from drivers.plant import Plant
from drivers.plant.motion import braked

STOPPED_WITHIN_S = 0.2
"""Allowed beyond the braking time until all arms rest."""
WATCHDOG_S = 0.2
"""Silence of the program after which a controller stops its arm."""
STALL = "a stall of the computer"
_ROUNDING_S = 1e-6

Vector = NDArray[np.float64]
Kind = Literal[
    "reading lost", "reading doubled", "reading false", "motion after a stop", "collision", "not listed", "calibration",
    "other",
]  # fmt: skip
KINDS_OF_FAILURE: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True)
class Failure:
    """What must never happen, and did."""

    kind: Kind
    text: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.text}"


@dataclass
class Monitor:
    """Watches a plant: what moved after a stop, what was measured, what was reported as stored.

    Attributes
    ----------
    violations : list of Failure
        What must never happen, and did.
    delivered : Counter
        Bytes of each point that the tracker returned -> how often.
    stored : dict
        (stop, arm) -> bytes of the point whose reading was reported as stored.
    """

    plant: Plant
    violations: list[Failure] = field(default_factory=list)
    delivered: Counter[bytes] = field(default_factory=Counter)
    stored: dict[tuple[int, str], bytes] = field(default_factory=dict)
    _latched: str = ""
    _releases: int = 0
    _reached_s: float = 0.0
    """Until then a watchdog has not stopped an arm that cannot be reached [s]."""
    _doubts: set[str] = field(default_factory=set)
    _reasons: set[str] = field(default_factory=set)
    _pausing: bool = False
    _paused: bool = False
    _digest: hashlib._Hash = field(default_factory=hashlib.sha256)

    @property
    def latched(self) -> bool:
        """Whether the arms must not move."""
        return bool(self._latched)

    def note(self, text: str) -> None:
        """Add an event to the digest of the campaign."""
        self._digest.update(f"{self.plant.clock_s!r} {text}\n".encode())

    def digest(self) -> str:
        """SHA-256 of all events so far: equal for equal campaigns."""
        return self._digest.hexdigest()

    def violation(self, kind: Kind, text: str) -> None:
        """Record what must never happen."""
        self.violations.append(Failure(kind, f"{text}, at {self.plant.clock_s:.3f} s"))

    # -- stops ---------------------------------------------------------------------------------------------------------

    def stop(self, reason: str, *, unreachable: bool = False) -> None:
        """All arms must brake now and stay at rest until ``release``.

        ``unreachable``: no program can reach one of the arms, so that the watchdog of its controller stops it.
        """
        self.note(f"stop {reason}")
        self._latched = self._latched or reason
        self._reasons.add(reason)
        releases = self._releases
        if unreachable:
            self._reached_s = self.plant.clock_s + WATCHDOG_S + _ROUNDING_S
        if self.plant.clock_s < self._reached_s:  # another stop does not reach that arm sooner
            self.plant.schedule.at(self._reached_s, lambda: self._expect_rest(reason, releases))
        else:
            self._expect_rest(reason, releases)

    def _expect_rest(self, reason: str, releases: int) -> None:
        if releases == self._releases and any(self.plant.moving(name) for name in self.plant.names):
            allowed_s = STOPPED_WITHIN_S + max(self._braking_s(name) for name in self.plant.names) + _ROUNDING_S
            self.plant.schedule.at(self.plant.clock_s + allowed_s, lambda: self._at_rest(reason, releases))

    def _braking_s(self, name: str) -> float:
        """Return the time that an arm would need to come to rest if it were stopped now [s]."""
        arm = self.plant._arm(name)
        shortened = None if arm.motion is None else braked(arm.motion, self.plant.clock_s, arm.config.acceleration)
        return 0.0 if shortened is None else shortened.duration_s

    def _at_rest(self, reason: str, releases: int) -> None:
        moving = [name for name in self.plant.names if self.plant.moving(name)]
        if moving and releases == self._releases:
            self.violation("motion after a stop", f"arm {', '.join(moving)} still moves after {reason}")

    def doubt(self, what: str) -> None:
        """A link is silent from now on: what moves may end its motion, and nothing begins until ``release``."""
        self.note(f"doubt {what}")
        self._doubts.add(what)

    def braked(self, name: str) -> None:
        """The program braked an arm."""
        if not self._latched:
            self.stop("the program's own stop")

    def resumed_by_itself(self) -> None:
        """The program goes on without a person, which a profile can allow after a stall of the computer only."""
        if self._reasons == {STALL}:
            self.release("the profile")

    def release(self, reason: str) -> None:
        """A person, or the profile, lets the arms move again."""
        self.note(f"release {reason}")
        self._latched = ""
        self._releases += 1
        self._reasons.clear()
        self._doubts.clear()
        self._pausing = self._paused = False

    def pause(self) -> None:
        """A person asked to hold after the present stop."""
        self.note("pause")
        self._pausing = True

    def started(self, name: str, q: Vector) -> None:
        """A motion of an arm began."""
        self.note(f"move {name} {q.tobytes().hex()}")
        if self._latched:
            self.violation("motion after a stop", f"motion of arm {name} after {self._latched}")
        if self._doubts:
            self.violation("motion after a stop", f"motion of arm {name} beside {', '.join(sorted(self._doubts))}")
        if self._paused:
            self.violation("motion after a stop", f"motion of arm {name} to another stop while paused")

    # -- measurements --------------------------------------------------------------------------------------------------

    def measured(self, p_M: Vector) -> None:
        """The tracker returned a point."""
        self.delivered[p_M.tobytes()] += 1
        self.note(f"point {p_M.tobytes().hex()}")

    def reported(self, stop: int, points: dict[str, Vector]) -> None:
        """The run file reported a stop as stored."""
        self.note(f"stored {stop} {' '.join(points)}")
        self._paused = self._pausing
        for name, p_M in points.items():
            if (stop, name) in self.stored:
                self.violation("reading doubled", f"stop {stop}, arm {name} was stored twice")
            self.stored[stop, name] = p_M.tobytes()
