"""Programme of the tests: the commands of an arm, and which positions the arms visit in which order."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from cellapp.cell.driving.iso9283.alignment import Alignment
from cellapp.cell.driving.iso9283.chosen_cube import ChosenCube, approach_sequence
from cellapp.cell.safety.gate import CellBodies, clear_stops, visible_stops
from cellapp.cell.targets.invert import LARGEST_CORRECTION, invert, with_approach
from cellapp.cell.targets.working_conditions import beside
from cellapp.estimation.iso9283.evaluate import ArmProgramme, Place
from cellapp.estimation.iso9283.norm import CYCLE, POSES, IsoCommands
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array, apply, rotation_from_vector
from cellapp.robot.model import CellModel


def arm_programme(
    model: CellModel,
    name: str,
    cube: ChosenCube,
    commands: IsoCommands,
    homes: Mapping[str, Array],
    *,
    rested_s: float,
    payload_kg: float,
    alignment: Alignment | None = None,
) -> ArmProgramme | str:
    """Return the commands of one arm for all positions of the tests, or why the model cannot command them.

    Calibrated commands assume that the arm has rested for ``rested_s`` [s] and came from the position before, with the
    other arm of a pair at home.
    """
    arm, names = model.arms[name], list(cube.q)
    position_B, q = np.array([cube.position_B[one] for one in names]), np.array([cube.q[one] for one in names])
    if commands == "nominal":
        wanted_M = apply(arm.nominal.T_M_B(), position_B)
        at = dict(zip(names, q, strict=True))
        sent = {(position, before): at[position] for position, before in legs()}
    else:
        T_M_B = arm.geometry.T_M_B()
        wanted_M = apply(T_M_B, position_B)
        rotation_M = np.broadcast_to(T_M_B[:3, :3] @ cube.rotation_B, (len(names), 3, 3))
        conditions = _conditions(model, name, homes, len(names), rested_s, payload_kg)
        found = invert(arm, wanted_M, rotation_M, q, conditions)
        if not (found.reached & (np.abs(found.q - q).max(axis=1) <= LARGEST_CORRECTION)).all():
            missed = int(np.argmin(found.reached))
            return f"the calibrated model does not reach {names[missed]} near the nominal joint positions"
        at = dict(zip(names, found.q, strict=True))
        row = conditions.take(np.array([0]))
        sent = {(position, before): with_approach(arm, at[position], at[before], row) for position, before in legs()}
    frame = np.zeros((len(names), 3, 3)) if alignment is None else alignment.position_covariance(q)
    return ArmProgramme(
        name=name,
        commands=commands,
        position_M=dict(zip(names, wanted_M, strict=True)),
        frame=dict(zip(names, frame, strict=True)),
        q=sent,
        rotation_M=_wanted_orientations(arm.nominal if commands == "nominal" else arm.geometry, cube, names),
    )


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


def _wanted_orientations(geometry: Geometry, cube: ChosenCube, names: Sequence[str]) -> dict[str, Array]:
    """Return the wanted orientation (3, 3) of the probe at each position, the same at all; empty without a probe."""
    if geometry.probe is None:
        return {}
    R_M_S = geometry.T_M_B()[:3, :3] @ cube.rotation_B @ rotation_from_vector(geometry.probe)
    return dict.fromkeys(names, R_M_S)


def _conditions(
    model: CellModel, name: str, homes: Mapping[str, Array], n: int, rested_s: float, payload_kg: float
) -> MeasurementConditions:
    """Return conditions of n commands: payload, rest until mid-measurement, the other arm of a pair at home."""
    stated = MeasurementConditions(payload_kg=np.full(n, payload_kg), dwell_s=np.full(n, rested_s))
    others = [other for other in model.arms if other != name]
    if len(others) != 1:
        return stated
    return beside(stated, model.arms[others[0]], np.tile(homes[others[0]], (n, 1)), None)
