"""Candidate stops of one arm (poses times approaches), the hypotheses to decide, and the design so far."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.plan import draw_stops
from cellapp.cell.planning.proposal.hypotheses import (
    CandidateDesign,
    Hypothesis,
    joined_context,
    open_hypotheses,
    refitted_discovery,
)
from cellapp.cell.planning.transit_paths import ArmRoadmap
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies
from cellapp.estimation.design.information import HOPELESS, Discrimination, SequentialDesign, joint_gains
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.outcome import Discovery
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken
from cellapp.robot.effects import DriverVariable, MeasurementConditions
from cellapp.robot.kinematics.statics import base_moment
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, CellModel

# -- Approaches to a pose: the last step of each joint and the dwell before the measurement ---------------------------


STEPS_RAD = (0.03, 0.5)
"""Small and large last step of a joint [rad]: within and far beyond the play and wind-up of a gear (1e-4 to 1e-3)."""
DWELLS_S = (0.5, 5.0)
"""Short and long rest before a measurement [s]: within and beyond the settling of an arm (about 1 s)."""


@dataclass(frozen=True, eq=False)
class Approaches:
    """The approaches (f of them) to each pose of one arm.

    ``steps`` (n, f, N) are last steps [rad], all zero without a detour; ``dwells`` (f,) [s].
    """

    steps: Array
    dwells: Array

    def __len__(self) -> int:
        return len(self.dwells)

    def first(self, poses: int) -> Approaches:
        """Return the approaches to the first ``poses`` poses."""
        return Approaches(self.steps[:poses], self.dwells)

    def needed_for(self, variables: Collection[DriverVariable]) -> Approaches:
        """Leave out detours and dwells that no variable depends on."""
        steps, dwells = self.steps, self.dwells
        if DriverVariable.DWELL not in variables:
            steps, dwells = steps[:, :: len(DWELLS_S)], np.zeros(len(dwells) // len(DWELLS_S))
        if not {DriverVariable.APPROACH, DriverVariable.STEP} & set(variables):
            dwells = np.unique(dwells)
            steps = np.zeros((len(steps), len(dwells), steps.shape[2]))
        return Approaches(steps, dwells)


def all_approaches(poses: int, joints: int, rng: np.random.Generator) -> Approaches:
    """Combine each of 12 last steps with each dwell.

    Signs: all joints forward, all backward, two opposite mixtures. Sizes: small, large, mixed.
    """
    mixed = rng.choice([-1.0, 1.0], (poses, 1, joints))
    forward = np.ones((poses, 1, joints))
    signs = np.concatenate([forward, -forward, mixed, -mixed], axis=1)
    small, large = STEPS_RAD
    sizes = (np.full(signs.shape, small), np.full(signs.shape, large), rng.choice(STEPS_RAD, signs.shape))
    steps = np.concatenate([signs * size for size in sizes], axis=1)
    return Approaches(np.repeat(steps, len(DWELLS_S), axis=1), np.tile(np.array(DWELLS_S), steps.shape[1]))


_MEMORY_BYTES = 3e8
"""Memory for the candidates' columns of one arm: a share that leaves room on a machine of 2 GB."""
_BYTES_A_COLUMN = 2 * 3 * 8
"""Memory of one column at one candidate: three coordinates in double precision, held twice by a discrimination."""
_LEAST_POSES = 20
"""Number of poses that are kept whatever the memory: fewer would leave no choice."""
_TYPICAL_DWELL_S = 0.7
"""Rest before a measurement [s] if a run has logged none: the settling time of the arms in the profiles."""
_LAST_READINGS = 5
"""Number of readings whose mean stands for the current joint temperatures."""


@dataclass(frozen=True, eq=False)
class RunConditions:
    """Conditions of further stops of one arm, taken from its run.

    Attributes
    ----------
    name : str
    other : (str, ArmModel), optional
        Name and model of the other arm.
    conditions : MeasurementConditions
        Of the readings of the run.
    count : int
        Number of further stops.
    """

    name: str
    other: tuple[str, ArmModel] | None
    conditions: MeasurementConditions
    count: int

    def candidates(
        self,
        poses: CandidatePoses,
        approaches: Approaches,
        pose: NDArray[np.intp],
        approach: NDArray[np.intp],
        load_kg: Array | None = None,
    ) -> tuple[Array, MeasurementConditions]:
        """Return configurations (m, N) [rad] and conditions of candidates; ``load_kg`` replaces the payload."""
        m, conditions = len(pose), self.conditions
        steps = approaches.steps[pose, approach]
        moment = other_q = None
        if self.other is not None:
            other, model = self.other
            other_q = poses.q[other][pose]
            moment = base_moment(model.geometry, model.bodies, other_q, model.up_M)
        detour = bool(steps.any())
        dwell_s, rested_s = None, conditions.dwell_s
        shortest_s = np.nanmin(rested_s) if rested_s is not None and np.isfinite(rested_s).any() else _TYPICAL_DWELL_S
        if rested_s is not None or approaches.dwells.any():
            dwell_s = approaches.dwells[approach] + shortest_s
        return poses.q[self.name][pose], MeasurementConditions(
            approach=np.sign(steps) if detour else None,
            step=steps if detour else None,
            dwell_s=dwell_s,
            time_s=self._times(m),
            payload_kg=last_known(conditions.payload_kg, m) if load_kg is None else load_kg,
            air_c=last_known(conditions.air_c, m),
            joints_c=last_known(conditions.joints_c, m),
            other_moment_M=moment,
            other_q=other_q,
            record=conditions.record,
        )

    def all_candidates(self, poses: CandidatePoses, approaches: Approaches) -> tuple[Array, MeasurementConditions]:
        """Return configurations and expected conditions of all candidates, pose by pose."""
        pose, approach = (each.ravel() for each in np.indices((len(poses), len(approaches))))
        return self.candidates(poses, approaches, pose, approach)

    def _times(self, m: int) -> Array | None:
        """Return the middle of the time in which the further stops will be measured, at the pace of the run."""
        time_s = self.conditions.time_s
        if time_s is None or not np.isfinite(time_s).any():
            return None
        ordered = np.sort(time_s[np.isfinite(time_s)])
        pace = float(np.median(np.diff(ordered))) if len(ordered) > 1 else 0.0
        return np.full(m, float(ordered[-1]) + pace * (0.5 * self.count + 1.0))


def last_known(values: Array | None, m: int) -> Array | None:
    """Return the last known value for m stops; of several channels (temperatures) the mean over the last readings."""
    if values is None:
        return None
    rows = values[np.isfinite(values).reshape(len(values), -1).all(axis=1)]
    if not len(rows):
        return None
    last = rows[-_LAST_READINGS:].mean(axis=0, keepdims=True) if values.ndim > 1 else rows[-1:]
    return np.repeat(last, m, axis=0)


@dataclass(frozen=True, eq=False)
class ArmHypotheses:
    """Hypotheses for further stops of one arm, the approaches that they need, and the largest number of poses."""

    run: RunConditions
    hypotheses: tuple[Hypothesis, ...]
    approaches: Approaches
    limits: Array
    affordable_poses: int

    @classmethod
    def of(
        cls,
        profile: Profile,
        name: str,
        model: CellModel,
        readings: Readings,
        conditions: MeasurementConditions,
        discovery: Discovery,
        poses: CandidatePoses,
        count: int,
        effort: Effort,
        rng: np.random.Generator,
    ) -> ArmHypotheses:
        """Derive the hypotheses from the outcome of discovery in the arm's readings."""
        arm = profile.arms[name]
        rows = np.concatenate([readings.in_split("identify"), readings.in_split("train")])
        rows = rows[~np.isin(readings.configuration[rows], discovery.result.left_out_configurations)]
        geometry_only = ArmData.of(profile, model.arms[name], readings.take(rows), conditions.take(rows))
        data, fit = refitted_discovery(geometry_only, discovery)
        others = [(other, model.arms[other]) for other in model.arms if other != name]
        run = RunConditions(name, others[0] if len(others) == 1 else None, conditions, count)
        approaches = all_approaches(len(poses), readings.joints, rng)
        joined = joined_context(data, *run.all_candidates(poses, approaches))
        hypotheses = tuple(open_hypotheses(data, fit, discovery, joined))
        approaches = approaches.needed_for(frozenset[DriverVariable]().union(*(one.variables for one in hypotheses)))
        columns = sum(one.columns_a_candidate for one in hypotheses)
        most = min(int(_MEMORY_BYTES / max(columns * _BYTES_A_COLUMN, 1)), effort.candidates) // len(approaches)
        limits = np.array(arm.joint_limits)
        return cls(run, hypotheses, approaches, limits, max(_LEAST_POSES, most))

    @property
    def variables(self) -> frozenset[DriverVariable]:
        """All variables that the hypotheses' models depend on."""
        return frozenset[DriverVariable]().union(*(one.variables for one in self.hypotheses))


@dataclass(eq=False)
class ArmCandidates:
    """Candidate stops of one arm (n poses, f approaches) while some of them are chosen.

    Attributes
    ----------
    run, approaches
    allowed : array, shape (n, f)
        Candidates that may still be chosen.
    comparisons : list of (Hypothesis, discriminations)
        Over all candidates.
    designs : list of (Hypothesis, SequentialDesign)
        Each discrimination with the candidates chosen so far.
    """

    run: RunConditions
    approaches: Approaches
    allowed: NDArray[np.bool_]
    comparisons: list[tuple[Hypothesis, list[Discrimination]]]
    designs: list[tuple[Hypothesis, SequentialDesign]]

    @classmethod
    def of(cls, arm: ArmHypotheses, poses: CandidatePoses) -> ArmCandidates:
        """Set up the discriminations over all candidates; last steps must start inside the joint limits."""
        approaches = arm.approaches.first(len(poses))
        start = poses.q[arm.run.name][:, None] - approaches.steps
        low, high = arm.limits.T
        q, conditions = arm.run.all_candidates(poses, approaches)
        designs: dict[int, CandidateDesign] = {}
        comparisons = []
        for one in arm.hypotheses:
            if id(one.fit) not in designs:
                designs[id(one.fit)] = CandidateDesign.of(one.data, one.fit, q, conditions)
            discriminations = one.discriminations(designs[id(one.fit)])
            comparisons.append((one, _decidable(discriminations, one.needed, arm.run.count)))
        begun = [(one, each.start_design()) for one, comparison in comparisons for each in comparison]
        return cls(arm.run, approaches, ((start >= low) & (start <= high)).all(axis=2), comparisons, begun)

    @property
    def name(self) -> str:
        """Name of the arm."""
        return self.run.name

    def gains(self, stops_left: int) -> Array:
        """Compute the gain (n, f) of each candidate over all hypotheses, at most 1; -inf where it is not allowed."""
        if not self.designs:
            return np.where(self.allowed, 0.0, -math.inf)
        needed = [one.needed for one, _ in self.designs]
        gains = joint_gains([design for _, design in self.designs], needed, stops_left)
        return np.where(self.allowed, gains.reshape(self.allowed.shape), -math.inf)

    def add(self, pose: int, approach: int) -> None:
        """Add a candidate to the designs; it cannot be chosen again."""
        for _, design in self.designs:
            design.add(pose * len(self.approaches) + approach)
        self.allowed[pose, approach] = False

    def start_of_last_step(self, poses: CandidatePoses, pose: int, approach: int) -> Array | None:
        """Return where the last step to a candidate begins (N,) [rad]; None if it has none."""
        step = self.approaches.steps[pose, approach]
        return poses.q[self.name][pose] - step if step.any() else None


def _decidable(comparison: list[Discrimination], needed: float, count: int) -> list[Discrimination]:
    """Drop laws that contain the effect itself (as dry friction contains backlash), unless all do."""
    decidable = []
    for one in comparison:
        design = one.start_design()
        most = design.noncentrality + count * float(design.gains().max(initial=0.0))
        if most > HOPELESS * needed:
            decidable.append(one)
    return decidable or comparison


# -- Candidate poses of all arms for further stops: visible to the tracker, free of collision, and easy to reach ------


@dataclass(frozen=True)
class Effort:
    """The number of candidates from which a proposal is chosen; its time grows in proportion.

    Attributes
    ----------
    drawn : int
        Poses that are drawn: enough that ``kept`` of them are within easy reach in the twin's crowded cell.
    kept : int
        Poses that are kept of these.
    candidates : int
        Upper limit of poses times approaches of one arm.
    """

    drawn: int = 840
    kept: int = 600
    candidates: int = 8000


@dataclass(frozen=True, eq=False)
class CandidatePoses:
    """Poses of all arms, drawn together.

    Attributes
    ----------
    q : mapping
        Arm -> joint positions (n, N) [rad].
    gate : CellBodies or None
        Checks motions; None where the profile does not describe the cell.
    homes : mapping
        Arm -> home position (N,) [rad]; empty without a gate.
    """

    q: Mapping[str, Array]
    gate: CellBodies | None
    homes: Mapping[str, Array]

    def __len__(self) -> int:
        return len(next(iter(self.q.values())))

    def first(self, count: int) -> CandidatePoses:
        """Return the first ``count`` poses."""
        return replace(self, q={name: q[:count] for name, q in self.q.items()})


def candidate_poses(
    profile: Profile, readings: Mapping[str, Readings], effort: Effort, rng: np.random.Generator, cancel: CancelToken
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
    reached = np.all([ArmRoadmap(profile, gate, name, rng).reaches(q) for name, q in drawn.items()], axis=0)
    if not reached.any():
        raise InputError("propose: no candidate can be reached; make plan.clearance smaller")
    return CandidatePoses({name: q[reached][: effort.kept] for name, q in drawn.items()}, gate, homes)


def _measured_poses(readings: Mapping[str, Readings], effort: Effort, rng: np.random.Generator) -> CandidatePoses:
    common = set.intersection(*(set(arm.configuration.tolist()) for arm in readings.values()))
    stops = rng.permutation(np.array(sorted(common), dtype=np.int64))[: effort.kept].tolist()
    if not stops:
        raise InputError("propose: the arms have no stop in common from which candidates could be made")
    q = {}
    for name, arm in readings.items():
        row_of = {stop: row for row, stop in enumerate(arm.configuration.tolist())}
        q[name] = arm.q[[row_of[stop] for stop in stops]]
    return CandidatePoses(q, None, {})


def alone(gate: CellBodies, name: str) -> CellBodies:
    """Return the cell with one arm only."""
    return replace(gate, arms={name: gate.arms[name]})
