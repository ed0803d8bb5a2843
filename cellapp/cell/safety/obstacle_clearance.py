"""Distances of arms at rest from each obstacle: of their bases, and of all that moves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.gate import CellBodies
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True)
class ObstacleClearance:
    """Distances of one arm from one obstacle of the cell.

    Attributes
    ----------
    obstacle, arm : str
    base : float
        Distance of the base bodies from it; zero or negative where they touch [m]. Infinite without base bodies.
    moving : float
        Least distance of the bodies that are checked against it [m]; infinite without any.
    asked : float
        The distance that these must keep [m].
    """

    obstacle: str
    arm: str
    base: float
    moving: float
    asked: float


def obstacle_clearances(cell: CellBodies, q: Mapping[str, Array]) -> Iterator[ObstacleClearance]:
    """Yield the distances of each arm of ``q`` (arm -> (N,) [rad]) from each obstacle of the cell."""
    for name, position in q.items():
        arm = cell.arms[name]
        bodies = place(arm, position[None])
        for obstacle, asked in zip(cell.obstacles, cell.obstacle_clearances[arm], strict=True):
            gaps = obstacle.gaps(bodies.start[0], bodies.end[0], bodies.radius, np.inf)
            checked = asked > -np.inf
            yield ObstacleClearance(
                obstacle.name,
                name,
                base=float(gaps[arm.frames == 0].min(initial=np.inf)),
                moving=float(gaps[checked].min(initial=np.inf)),
                asked=float(asked.max(initial=-np.inf)),
            )
