"""Candidate poses of all arms for further stops: visible to the tracker, free of collision, and easy to reach."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.plan import draw_stops, rolled_stops
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies
from cellapp.cell.safety.many_motions import free_motions
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken
from cellapp.robot.kinematics.transforms import Array

_NEIGHBOURS = 7
"""Number of other poses (besides home) from which a straight motion to a pose is checked."""
_LEAST_REACHED_FROM = 3
"""Number of these motions that must be free: an isolated pose (above the floor, folded) rarely fits into an order."""


@dataclass(frozen=True)
class Effort:
    """The number of candidates from which a proposal is chosen; its time grows in proportion.

    Attributes
    ----------
    drawn : int
        Poses that are drawn: enough that ``kept`` of them are within easy reach in the twin's crowded cell.
    kept : int
        Poses that are kept of these.
    rolls : int
        Copies of each with other angles of the last joint, which rotate the SMR with little motion.
    candidates : int
        Upper limit of poses times approaches of one arm.
    """

    drawn: int = 280
    kept: int = 200
    rolls: int = 2
    candidates: int = 8000


@dataclass(frozen=True, eq=False)
class CandidatePoses:
    """Poses of all arms, drawn together.

    Attributes
    ----------
    q : mapping
        Arm -> joint positions (n, N) [rad].
    posture : array, shape (n,)
        Number shared by poses that differ in wrist rolls only.
    gate : CellBodies or None
        Checks motions; None where the profile does not describe the cell.
    homes : mapping
        Arm -> home position (N,) [rad]; empty without a gate.
    """

    q: Mapping[str, Array]
    posture: NDArray[np.intp]
    gate: CellBodies | None
    homes: Mapping[str, Array]

    def __len__(self) -> int:
        return len(self.posture)

    def first(self, count: int) -> CandidatePoses:
        """Return the first ``count`` poses."""
        return replace(self, q={name: q[:count] for name, q in self.q.items()}, posture=self.posture[:count])


def candidate_poses(
    profile: Profile,
    readings: Mapping[str, Readings],
    effort: Effort,
    rng: np.random.Generator,
    cancel: CancelToken,
) -> tuple[CandidatePoses, list[str]]:
    """Draw poses in the cell that the profile describes, else take the measured configurations; and return notes.

    Raises
    ------
    InputError
        If there are none.
    """
    described = profile.tracker.pose is not None and all(
        arm.base is not None and arm.home is not None and arm.type.capsules for arm in profile.arms.values()
    )
    if described:
        return _drawn_poses(profile, effort, rng, cancel), []
    note = (
        "candidates are configurations that were measured, as the profile does not say where arms and tracker stand;"
        " the motions to them were not checked for collisions"
    )
    return _measured_poses(readings, effort, rng), [note]


def _drawn_poses(profile: Profile, effort: Effort, rng: np.random.Generator, cancel: CancelToken) -> CandidatePoses:
    gate, homes = cell_bodies(profile), home_positions(profile)
    drawn = draw_stops(gate, profile, effort.drawn, rng, cancel)
    reached = np.all([_within_reach(gate, name, q, homes[name]) for name, q in drawn.items()], axis=0)
    if not reached.any():
        raise InputError("propose: no candidate can be reached on a straight motion; make plan.clearance smaller")
    kept = {name: q[reached][: effort.kept] for name, q in drawn.items()}
    q, posture = rolled_stops(gate, kept, effort.rolls, rng)
    mixed = rng.permutation(len(posture))
    return CandidatePoses({name: rows[mixed] for name, rows in q.items()}, posture[mixed], gate, homes)


def _measured_poses(readings: Mapping[str, Readings], effort: Effort, rng: np.random.Generator) -> CandidatePoses:
    common = set.intersection(*(set(arm.configuration.tolist()) for arm in readings.values()))
    most = effort.kept * (1 + effort.rolls)
    stops = rng.permutation(np.array(sorted(common), dtype=np.int64))[:most].tolist()
    if not stops:
        raise InputError("propose: the arms have no stop in common from which candidates could be made")
    q = {}
    for name, arm in readings.items():
        row_of = {stop: row for row, stop in enumerate(arm.configuration.tolist())}
        q[name] = arm.q[[row_of[stop] for stop in stops]]
    return CandidatePoses(q, np.arange(len(stops)), None, {})


def _within_reach(gate: CellBodies, name: str, q: Array, home: Array) -> NDArray[np.bool_]:
    """Mask (n,) of configurations (n, N) that an arm alone in the cell reaches on straight motions from others."""
    without_others = alone(gate, name)
    free = np.zeros(len(q), dtype=np.intp)
    neighbours = (np.roll(q, -1 - i, axis=0) for i in range(min(_NEIGHBOURS, len(q) - 1)))
    for start in (np.broadcast_to(home, q.shape), *neighbours):
        left = np.flatnonzero(free < _LEAST_REACHED_FROM)
        free[left] += free_motions(without_others, {name: start[left]}, {name: q[left]})
    return np.asarray(free >= _LEAST_REACHED_FROM)


def alone(gate: CellBodies, name: str) -> CellBodies:
    """Return the cell with one arm only."""
    return replace(gate, arms={name: gate.arms[name]})
