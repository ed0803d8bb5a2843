"""Paths that arms follow at once: how far they may be from where all of them are at one place of their paths.

Each controller keeps a time of its own: one arm may set out a little later than another, or fall behind. The gate
accepts paths of several arms with a margin (``allowed_apart_m``); while they move, what they are apart is computed from
their joints (``PathsAtOnce.apart_m``), and more than ``MOST_APART_M`` of it is a doubt, which stops all arms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cellapp.cell.safety.gate import CellBodies
from cellapp.robot.kinematics.interpolation import rows_at
from cellapp.robot.kinematics.transforms import Array

MOST_APART_M = 0.05
"""What arms may be apart before all of them are stopped [m]."""
LOOK_S = 0.1
"""Longest wait for one arm before all are looked at."""
_REACTION_S = 0.5
"""In this time what they are apart is seen, and the arms are braked: two waits, an old state, a way to come to rest."""


def allowed_apart_m(cell: CellBodies, paths: Mapping[str, Array], period_s: float) -> float:
    """How far the arms of ``paths``, arm -> (m, N) [rad], one row each ``period_s`` [s], may come to be from where all
    of them are at one row [m]; 0 for one arm.

    When of two arms one is late, either it or the other is off its place; so the slower one counts.
    """
    if len(paths) < 2:
        return 0.0
    steps_m = [float((np.abs(np.diff(q, axis=0)) @ cell.arms[name].levers).max()) for name, q in paths.items()]
    return MOST_APART_M + _REACTION_S * sorted(steps_m)[-2] / period_s


@dataclass(frozen=True, eq=False)
class PathsAtOnce:
    """Paths of several arms, arm -> (m, N) [rad], of one time for each row."""

    cell: CellBodies
    paths: Mapping[str, Array]

    def apart_m(self, q: Mapping[str, Array]) -> float:
        """How far arms at ``q`` (arm -> (N,) [rad]) are from where all of them are at one row, at most [m]."""
        off = [np.abs(path - q[name]) @ self.cell.arms[name].levers for name, path in self.paths.items()]
        return float(np.sum(off, axis=0).min())


def on_rows(q: Array, period_s: float, wanted_s: float) -> Array:
    """A path ``q`` (m, N) with a row each ``period_s`` [s] as one with a row each ``wanted_s`` [s]."""
    if period_s == wanted_s:
        return q
    time_s = np.arange(len(q)) * period_s
    times = np.arange(int(np.ceil(time_s[-1] / wanted_s)) + 1) * wanted_s
    return rows_at(times, time_s, q)


def equally_long(paths: Mapping[str, Array]) -> dict[str, Array]:
    """Paths (m, N) of arms of which those that end earlier rest at their ends."""
    rows = max(map(len, paths.values()))
    return {name: np.concatenate([q, np.repeat(q[-1:], rows - len(q), axis=0)]) for name, q in paths.items()}
