"""Paths that arms follow simultaneously, and how far the arms are from being at the same row of them.

Each controller has its own clock: one arm may start a little later than another, or fall behind. The gate accepts paths
of several arms with a margin (``allowed_apart_m``). While they move, the deviation from the same row is computed from
their joints (``PathsAtOnce.apart_m``); more than ``MOST_APART_M`` is a doubt, which stops all arms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cellapp.cell.safety.gate import CellBodies
from cellapp.robot.kinematics.interpolation import rows_at
from cellapp.robot.kinematics.transforms import Array

MOST_APART_M = 0.05
"""Deviation of the arms from the same row at which all of them are stopped [m]."""
LOOK_S = 0.1
"""Longest wait for one arm before the states of all are read."""
_REACTION_S = 0.5
"""Time to detect the deviation and to brake the arms: two waits, an old state, the braking itself."""


def allowed_apart_m(cell: CellBodies, paths: Mapping[str, Array], period_s: float) -> float:
    """Compute how far the arms of ``paths``, arm -> (m, N) [rad], one row each ``period_s`` [s], may deviate from all
    being at one row [m]; 0 for one arm.

    If one of two arms is late, either may be taken as the one off its place; so the slower one counts.
    """
    if len(paths) < 2:
        return 0.0
    steps_m = [float((np.abs(np.diff(q, axis=0)) @ cell.arms[name].levers).max()) for name, q in paths.items()]
    return MOST_APART_M + _REACTION_S * sorted(steps_m)[-2] / period_s


@dataclass(frozen=True, eq=False)
class PathsAtOnce:
    """Paths of several arms, arm -> (m, N) [rad]; all arms are to be at the same row at the same time."""

    cell: CellBodies
    paths: Mapping[str, Array]

    def apart_m(self, q: Mapping[str, Array]) -> float:
        """Compute how far arms at ``q`` (arm -> (N,) [rad]) are at most from all being at one row [m]."""
        off = [np.abs(path - q[name]) @ self.cell.arms[name].levers for name, path in self.paths.items()]
        return float(np.sum(off, axis=0).min())


def on_rows(q: Array, period_s: float, wanted_s: float) -> Array:
    """Resample a path ``q`` (m, N) from a row each ``period_s`` [s] to a row each ``wanted_s`` [s]."""
    if period_s == wanted_s:
        return q
    time_s = np.arange(len(q)) * period_s
    times = np.arange(int(np.ceil(time_s[-1] / wanted_s)) + 1) * wanted_s
    return rows_at(times, time_s, q)


def equally_long(paths: Mapping[str, Array]) -> dict[str, Array]:
    """Extend the paths (m, N) of arms that end earlier: these rest at their ends."""
    rows = max(map(len, paths.values()))
    return {name: np.concatenate([q, np.repeat(q[-1:], rows - len(q), axis=0)]) for name, q in paths.items()}
