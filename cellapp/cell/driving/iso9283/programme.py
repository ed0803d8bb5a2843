"""Programme of the tests: which positions the arms visit in which order, and to which test each visit belongs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from cellapp.cell.driving.iso9283.chosen_cube import approach_sequence
from cellapp.cell.safety.gate import CellBodies, clear_stops, visible_stops
from cellapp.estimation.iso9283.cube import CYCLE, POSES
from cellapp.estimation.iso9283.norm import NORM_CYCLES, IsoTest
from cellapp.estimation.iso9283.places import ArmProgramme, Place
from cellapp.robot.kinematics.transforms import Array


def wanted_cycles(test: IsoTest, cycles: int) -> int:
    """Return the number of cycles of a test if ``cycles`` were requested: some take no more than the standard's."""
    return min(cycles, NORM_CYCLES[test]) if test in ("drift", "path") else cycles


@dataclass(frozen=True, eq=False)
class Visit:
    """One motion: arm -> joint positions (N,) [rad]. ``place`` is None if nothing is measured."""

    targets: Mapping[str, Array]
    place: Place | None
    cycle: int


def legs() -> list[tuple[str, str]]:
    """Return all positions that the tests of one arm drive to, each with the position before it."""
    around, approaches = [CYCLE[-1], *CYCLE], approach_sequence()
    found = [*zip(around, CYCLE, strict=False), ("P4", "P2"), ("P2", "P4")]
    found += zip([approaches[-1], *approaches], approaches, strict=False)
    return [(position, before) for before, position in dict.fromkeys(found)]


def pose_visits(arm: ArmProgramme, cycles: int, speed: float = 0.0) -> Iterator[Visit]:
    """Yield the pose test: to P1, then cycles P5, P4, P3, P2, P1; ``speed`` as in ``Place``."""
    yield _passing(arm, "P1", "P2")
    for cycle in range(cycles):
        for position in CYCLE:
            place = arm.place("pose", position, speed=speed)
            yield Visit({arm.name: arm.q[position, _before(position)]}, place, cycle)


def distance_visits(arm: ArmProgramme, cycles: int) -> Iterator[Visit]:
    """Yield the distance test: P2 and P4 alternately."""
    yield _passing(arm, "P2", "P4")
    yield _passing(arm, "P4", "P2")
    for cycle in range(cycles):
        for position, before in (("P2", "P4"), ("P4", "P2")):
            yield Visit({arm.name: arm.q[position, before]}, arm.place("distance", position), cycle)


def directional_visits(arm: ArmProgramme, cycles: int) -> Iterator[Visit]:
    """Yield the multi-directional test: P1, P2 and P4, each approached along x, y and z."""
    sequence = approach_sequence()
    for cycle in range(cycles):
        for before, position in zip([sequence[-1], *sequence], sequence, strict=False):
            pose = position.split()[0]
            place = None if pose != position else arm.place("multidirectional", pose, before.split()[1])
            yield Visit({arm.name: arm.q[position, before]}, place, cycle)


def drift_visits(arm: ArmProgramme, cycles: int) -> Iterator[Visit]:
    """Yield one group of the drift test: cycles P5 to P1, measured only at P1."""
    for cycle in range(cycles):
        yield from _exercise(arm, cycle, arm.place("drift", "P1"))


def exercise_visits(arm: ArmProgramme) -> Iterator[Visit]:
    """Yield one cycle between two groups of the drift test."""
    yield from _exercise(arm, 0, None)


def paired_visits(
    first: ArmProgramme, second: ArmProgramme, pairs: Sequence[tuple[str, str]], cycles: int
) -> Iterator[Visit]:
    """Yield the cooperative test: both arms to each pair of poses together, always in the same order."""
    for cycle in range(cycles):
        for a, b in pairs:
            place = Place("cooperative", first.commands, (first.name, second.name), (a, b))
            targets = {first.name: first.q[a, _before(a)], second.name: second.q[b, _before(b)]}
            yield Visit(targets, place, cycle)


def pose_pairs(
    cell: CellBodies, homes: Mapping[str, Array], q: Mapping[str, Mapping[str, Array]]
) -> list[tuple[str, str]]:
    """Pair poses that two arms can take together, clear and both visible; each at most once, in the standard's order.

    ``q`` maps both arms to their nominal joint positions by pose. Find as many pairs as possible, equal names first.
    """
    first, second = q
    both = [(a, b) for a in CYCLE for b in CYCLE]
    n = len(both)
    stops = {name: np.tile(home, (n, 1)) for name, home in homes.items()}
    stops[first] = np.array([q[first][a] for a, _ in both])
    stops[second] = np.array([q[second][b] for _, b in both])
    seen = {name: stops[name] for name in (first, second)}
    holds = (clear_stops(cell, stops) & visible_stops(cell, seen)).reshape(len(CYCLE), len(CYCLE))
    other = 1.0 - np.eye(len(CYCLE))
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(holds, other, 10.0 * len(POSES)))
    return [(CYCLE[i], CYCLE[k]) for i, k in zip(rows, columns, strict=True) if holds[i, k]]


# -- inside -----------------------------------------------------------------------------------------------------------


def _exercise(arm: ArmProgramme, cycle: int, at_end: Place | None) -> Iterator[Visit]:
    for position in CYCLE:
        place = at_end if position == CYCLE[-1] else None
        yield Visit({arm.name: arm.q[position, _before(position)]}, place, cycle)


def _passing(arm: ArmProgramme, position: str, before: str) -> Visit:
    return Visit({arm.name: arm.q[position, before]}, None, 0)


def _before(position: str) -> str:
    """Return the position before this one in a cycle."""
    return CYCLE[CYCLE.index(position) - 1]
