"""Recent history of an arm, as a tracker that sends packets measures points of the recent past.

A phase is a time in which neither the motion nor the memories of the arm change. In a stream of positions it lasts one
control cycle; the memories change when a joint reverses.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Protocol

import numpy as np

from drivers.plant.config import Array
from drivers.plant.motion import AnyMotion

LONGEST = 512
"""Number of phases that are stored: a second of a stream of 500 Hz."""


@dataclass(frozen=True, eq=False)
class Phase:
    """Time until ``until_s`` [s] in which an arm made ``motion`` or rested (None); other fields as in ``TrueArm``."""

    until_s: float
    motion: AnyMotion | None
    q: Array
    memories: Sequence[Array | None]
    approach: Array
    last_step: Array
    rest_since_s: float

    def positions(self, time_s: Array) -> Array:
        """Return joint positions (n, N) at times (n,) [rad]."""
        return np.repeat(self.q[None], len(time_s), axis=0) if self.motion is None else self.motion.position(time_s)


class Trailing(Protocol):
    """The part of an arm's state that a phase needs."""

    motion: AnyMotion | None
    q: Array
    memories: list[Array | None]
    approach: Array
    last_step: Array
    rest_since_s: float
    trail: deque[Phase]


def phase_of(arm: Trailing, until_s: float) -> Phase:
    """Return the current phase of an arm, ending at ``until_s`` [s]."""
    return Phase(until_s, arm.motion, arm.q, arm.memories, arm.approach, arm.last_step, arm.rest_since_s)


def note_phase(arm: Trailing, until_s: float) -> None:
    """Store the phase that ends at ``until_s`` [s]; call it before motion or memories change."""
    arm.trail.append(phase_of(arm, until_s))


def joints_at(arm: Trailing, time_s: Array, now_s: float) -> tuple[Array, list[tuple[Phase, np.ndarray]]]:
    """Return joint positions (n, N) [rad] at recent times (n,), and the phases with the rows of their times."""
    first_s = float(np.min(time_s, initial=now_s))
    lasted = takewhile(lambda phase: phase.until_s >= first_s, reversed(arm.trail))  # some milliseconds out of a second
    phases = [phase_of(arm, now_s), *lasted][::-1]
    number = np.searchsorted([phase.until_s for phase in phases[:-1]], time_s, side="left")
    q = np.empty((len(time_s), len(arm.q)))
    known: list[tuple[Phase, np.ndarray]] = []
    for one in np.unique(number):
        phase, rows = phases[one], np.flatnonzero(number == one)
        q[rows] = phase.positions(time_s[rows])
        before, earlier = known[-1] if known else (None, rows)
        if before is not None and before.q is phase.q and (before.motion is None) == (phase.motion is None):
            known[-1] = before, np.concatenate([earlier, rows])
        else:
            known.append((phase, rows))
    return q, known
