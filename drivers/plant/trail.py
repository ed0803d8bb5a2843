"""What an arm did a moment ago: a tracker that sends packets measures points that have passed.

A phase is a time in which neither the motion nor the memories of the arm changed. In a stream of positions one lasts a
control cycle; the memories change where a joint turns round.
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
"""Phases that are kept: a second of a stream of 500 Hz."""


@dataclass(frozen=True, eq=False)
class Phase:
    """Until ``until_s`` [s] the arm made ``motion``, or rested; the rest as in ``TrueArm``."""

    until_s: float
    motion: AnyMotion | None
    q: Array
    memories: Sequence[Array | None]
    approach: Array
    last_step: Array
    rest_since_s: float

    def positions(self, time_s: Array) -> Array:
        """Joint positions (n, N) at times (n,) [rad]."""
        return np.repeat(self.q[None], len(time_s), axis=0) if self.motion is None else self.motion.position(time_s)


class Trailing(Protocol):
    """The state of an arm, as far as a phase needs it."""

    motion: AnyMotion | None
    q: Array
    memories: list[Array | None]
    approach: Array
    last_step: Array
    rest_since_s: float
    trail: deque[Phase]


def phase_of(arm: Trailing, until_s: float) -> Phase:
    """The phase of an arm that lasts until ``until_s`` [s]."""
    return Phase(until_s, arm.motion, arm.q, arm.memories, arm.approach, arm.last_step, arm.rest_since_s)


def note_phase(arm: Trailing, until_s: float) -> None:
    """Keep the phase that ends at ``until_s`` [s]; called before motion or memories change."""
    arm.trail.append(phase_of(arm, until_s))


def joints_at(arm: Trailing, time_s: Array, now_s: float) -> tuple[Array, list[tuple[Phase, np.ndarray]]]:
    """Joint positions (n, N) [rad] at recent times (n,), and rows by what the arm remembered then."""
    first_s = float(np.min(time_s, initial=now_s))
    lasted = takewhile(lambda phase: phase.until_s >= first_s, reversed(arm.trail))  # of a second, some milliseconds
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
