"""Proposal of further stops, and of how to approach them, that best decide what discovery left open.

Candidate stops of one arm (poses times approaches), the hypotheses to decide, and the design so far.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.hypotheses import (
    CandidateDesign,
    Hypothesis,
    joined_context,
    open_hypotheses,
    refitted_discovery,
)
from cellapp.cell.planning.plan import sample_stops
from cellapp.cell.planning.planned_stops import (
    PlannedStops,
    begin_of,
    can_go,
    joined,
    read_planned_stops,
    straight_stops,
    write_planned_stops,
)
from cellapp.cell.planning.transit_paths import ArmRoadmap
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, refuse_motion, visible_stops
from cellapp.estimation.calibration.quantities import ArmReadings
from cellapp.estimation.design.information import HOPELESS, SequentialDesign, TwoModels, joint_gains
from cellapp.estimation.discovery.arm_data import UNKNOWN, ArmData
from cellapp.estimation.discovery.outcome import ArmFound
from cellapp.estimation.discovery.records import Discrimination, ProposalQuestion, Unnamed
from cellapp.estimation.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.robot.effects import EFFECTS, InputVariable, MeasurementConditions, place_in_words, varies
from cellapp.robot.kinematics.statics import base_moment
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.nominal import prior_sigmas

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

    def needed_for(self, variables: Collection[InputVariable]) -> Approaches:
        """Leave out detours and dwells that no variable depends on."""
        steps, dwells = self.steps, self.dwells
        if InputVariable.DWELL not in variables:
            steps, dwells = steps[:, :: len(DWELLS_S)], np.zeros(len(dwells) // len(DWELLS_S))
        if not {InputVariable.APPROACH, InputVariable.STEP} & set(variables):
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
class CandidateStops:
    """Candidates for further stops of one arm: each pose by each approach, under the conditions of its run.

    Attributes
    ----------
    name : str
    poses : CandidatePoses
        Of all arms (n of them).
    approaches : Approaches
        To n poses at least.
    other : (str, ArmModel), optional
        Name and model of the other arm.
    conditions : MeasurementConditions
        Of the readings of the run.
    count : int
        Number of further stops.
    """

    name: str
    poses: CandidatePoses
    approaches: Approaches
    other: tuple[str, ArmModel] | None
    conditions: MeasurementConditions
    count: int

    def at(
        self, pose: NDArray[np.intp], approach: NDArray[np.intp], load_kg: Array | None = None
    ) -> tuple[Array, MeasurementConditions]:
        """Return configurations (m, N) [rad] and conditions of some of them; ``load_kg`` replaces the payload."""
        m, conditions = len(pose), self.conditions
        steps = self.approaches.steps[pose, approach]
        moment = other_q = None
        if self.other is not None:
            other, model = self.other
            other_q = self.poses.q[other][pose]
            moment = base_moment(model.geometry, model.bodies, other_q, model.up_M)
        detour = bool(steps.any())
        dwell_s, rested_s = None, conditions.dwell_s
        shortest_s = np.nanmin(rested_s) if rested_s is not None and np.isfinite(rested_s).any() else _TYPICAL_DWELL_S
        if rested_s is not None or self.approaches.dwells.any():
            dwell_s = self.approaches.dwells[approach] + shortest_s
        return self.poses.q[self.name][pose], MeasurementConditions(
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

    def every(self) -> tuple[Array, MeasurementConditions]:
        """Return configurations and expected conditions of all candidates, pose by pose."""
        pose, approach = (each.ravel() for each in np.indices((len(self.poses), len(self.approaches))))
        return self.at(pose, approach)

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


def open_questions(
    measured: ArmReadings,
    models: Mapping[str, ArmModel],
    discovery: ArmFound,
    poses: CandidatePoses,
    count: int,
    rng: np.random.Generator,
) -> tuple[CandidateStops, list[Hypothesis]]:
    """Derive the hypotheses from the outcome of discovery in an arm's readings; return the candidates they need."""
    profile, name, readings = measured.profile, measured.name, measured.readings
    rows = readings.in_split("identify", "train")
    rows = rows[~np.isin(readings.configuration[rows], discovery.result.left_out_configurations)]
    sigma = prior_sigmas(measured.model.nominal, profile.calibration.priors, profile.arms[name].fixed)
    data, fit = refitted_discovery(ArmData.of(measured.take(rows), sigma), discovery)
    others = [(other, model) for other, model in models.items() if other != name]
    other = others[0] if len(others) == 1 else None
    approaches = all_approaches(len(poses), readings.joints, rng)
    stops = CandidateStops(name, poses, approaches, other, measured.conditions, count)
    hypotheses = open_hypotheses(data, fit, discovery, joined_context(data, *stops.every()))
    return replace(stops, approaches=approaches.needed_for(_variables(hypotheses))), hypotheses


def _variables(hypotheses: Sequence[Hypothesis]) -> frozenset[InputVariable]:
    """Return all variables that the hypotheses' models depend on."""
    return frozenset[InputVariable]().union(*(one.variables for one in hypotheses))


def _affordable_poses(stops: CandidateStops, hypotheses: Sequence[Hypothesis], most: int) -> int:
    """Return the number of poses of an arm for which the memory is enough, with at most ``most`` candidates."""
    columns = sum(one.columns_a_candidate for one in hypotheses)
    within_memory = int(_MEMORY_BYTES / max(columns * _BYTES_A_COLUMN, 1))
    return max(_LEAST_POSES, min(within_memory, most) // len(stops.approaches))


@dataclass(eq=False)
class ArmCandidates:
    """Candidates of one arm (n poses, f approaches) while some of them are chosen.

    Attributes
    ----------
    stops
        The candidates.
    allowed : array, shape (n, f)
        Candidates that may still be chosen.
    used : array, shape (n,)
        How often each pose is chosen.
    comparisons : list of (Hypothesis, discriminations)
        Over all candidates.
    designs : list of (Hypothesis, SequentialDesign)
        Each discrimination with the candidates chosen so far.
    """

    stops: CandidateStops
    allowed: NDArray[np.bool_]
    used: NDArray[np.intp]
    comparisons: list[tuple[Hypothesis, list[TwoModels]]]
    designs: list[tuple[Hypothesis, SequentialDesign]]

    @classmethod
    def of(cls, stops: CandidateStops, hypotheses: Sequence[Hypothesis], limits: Array) -> ArmCandidates:
        """Set up the discriminations over all candidates; last steps must start inside the joint limits (N, 2)."""
        poses = len(stops.poses)
        start = stops.poses.q[stops.name][:, None] - stops.approaches.steps[:poses]
        low, high = limits.T
        every = stops.every()
        designs: dict[int, CandidateDesign] = {}
        comparisons, begun = [], []
        for one in hypotheses:
            if id(one.fit) not in designs:
                designs[id(one.fit)] = CandidateDesign.of(one.data, one.fit, *every)
            both = [(each, each.start_design()) for each in one.discriminations(designs[id(one.fit)])]
            both = _decidable(both, one.needed, stops.count)
            comparisons.append((one, [each for each, _ in both]))
            begun += [(one, design) for _, design in both]
        allowed = ((start >= low) & (start <= high)).all(axis=2)
        return cls(stops, allowed, np.zeros(poses, dtype=np.intp), comparisons, begun)

    def gains(self, stops: int) -> Array:
        """Compute the gain (n, f) of each candidate over all hypotheses, at most 1; -inf where it is not allowed."""
        if not self.designs:
            return np.where(self.allowed, 0.0, -math.inf)
        needed = [one.needed for one, _ in self.designs]
        gains = joint_gains([design for _, design in self.designs], needed, stops)
        return np.where(self.allowed, gains.reshape(self.allowed.shape), -math.inf)

    def add(self, pose: int, approach: int) -> None:
        """Add a candidate to the designs; it cannot be chosen again."""
        for _, design in self.designs:
            design.add(pose * len(self.stops.approaches) + approach)
        self.used[pose] += 1
        self.allowed[pose, approach] = False
        if self.used[pose] == _MOST_OFTEN:
            self.allowed[pose] = False


def _decidable(
    comparison: list[tuple[TwoModels, SequentialDesign]], needed: float, count: int
) -> list[tuple[TwoModels, SequentialDesign]]:
    """Drop laws that contain the effect itself (as dry friction contains backlash), unless all do."""
    most = [design.noncentrality + count * float(design.gains().max(initial=0.0)) for _, design in comparison]
    return [one for one, its in zip(comparison, most, strict=True) if its > HOPELESS * needed] or comparison


# -- Candidate poses of all arms for further stops: visible to the tracker, free of collision, and easy to reach ------


@dataclass(frozen=True)
class Effort:
    """The number of candidates from which a proposal is chosen; its time grows in proportion.

    Attributes
    ----------
    sampled : int
        Poses that are sampled: enough that ``kept`` of them are within easy reach in the twin's crowded cell.
    kept : int
        Poses that are kept of these.
    candidates : int
        Upper limit of poses times approaches of one arm.
    """

    sampled: int = 840
    kept: int = 600
    candidates: int = 8000


@dataclass(frozen=True, eq=False)
class CandidatePoses:
    """Poses of all arms, sampled together.

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
    profile: Profile, readings: Mapping[str, Readings], effort: Effort, rng: np.random.Generator, job: JobToken
) -> tuple[CandidatePoses, list[str]]:
    """Sample poses in the cell that the profile describes, else take the measured configurations; and return notes.

    Raises
    ------
    InputError
        If there are none.
    """
    described = profile.tracker.pose is not None and all(
        arm.base is not None and arm.home is not None and arm.type.capsules for arm in profile.arms.values()
    )
    if not described:
        note = (
            "candidates are configurations that were measured, as the profile does not say where arms and tracker"
            " stand; the motions to them were not checked for collisions"
        )
        return _measured_poses(readings, effort, rng), [note]
    gate, homes = cell_bodies(profile), home_positions(profile)
    sampled = sample_stops(gate, profile, effort.sampled, rng, job)
    reached = np.all([ArmRoadmap(profile, gate, name, rng).reaches(q) for name, q in sampled.items()], axis=0)
    if not reached.any():
        raise InputError("propose: no candidate can be reached; make plan.clearance smaller")
    return CandidatePoses({name: q[reached][: effort.kept] for name, q in sampled.items()}, gate, homes), []


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


# -- Value of proposed stops: discrimination of each hypothesis now, with them, and with equally many random ones -----


_RANDOM_DESIGNS = 8
"""Number of random designs that are averaged for comparison, so that no single sample decides."""
_LOAD_SHARE = 0.25
"""Suggested further payload as a share of the arm's own mass: what arms of this class may carry."""
_LEAST_LOAD_STEP_KG = 0.5
"""Suggested payloads are multiples of this: common weights."""
_WORTH_A_LOAD = 1.5
"""Factor by which another payload must raise the discrimination to be suggested."""


def predict_arm(
    arm: ArmCandidates, pose: NDArray[np.intp], approach: NDArray[np.intp], rng: np.random.Generator
) -> tuple[list[ProposalQuestion], list[str]]:
    """Predict what the chosen candidates decide of an arm's hypotheses; return also advice to change its payload."""
    chosen = pose * len(arm.stops.approaches) + approach
    samples = [rng.integers(0, arm.allowed.size, len(chosen)) for _ in range(_RANDOM_DESIGNS)]
    nothing = np.array([], dtype=np.intp)
    questions, advice = [], []
    for one, comparison in arm.comparisons:
        proposed, random = _least(comparison, chosen), float(np.mean([_least(comparison, each) for each in samples]))
        question = ProposalQuestion(
            effect=one.effect,
            against=one.against or None,
            needed=one.needed,
            discrimination=Discrimination(now=_least(comparison, nothing), proposed=proposed, random=random),
            gain_over_random=proposed / max(random, 1e-12),
        )
        questions.append(question)
        advice += _load_advice(arm.stops, one, pose, approach, proposed)
    return questions, advice


def _least(comparison: Sequence[TwoModels], chosen: NDArray[np.intp]) -> float:
    """Return the least discrimination over the laws of the alternative."""
    return min(one.noncentrality(chosen) for one in comparison)


def _load_advice(
    stops: CandidateStops, hypothesis: Hypothesis, pose: NDArray[np.intp], approach: NDArray[np.intp], proposed: float
) -> list[str]:
    """Advise another payload at every second stop, if the stops do not decide and the run had one payload."""
    payload_kg = stops.conditions.payload_kg
    depends = any(InputVariable.PAYLOAD in EFFECTS[slug].variables for slug in hypothesis.effects)
    decided = bool(hypothesis.against) and proposed >= hypothesis.needed
    if not depends or decided or varies(payload_kg):
        return []
    bodies = hypothesis.data.model.bodies
    present = last_known(payload_kg, 1)
    now_kg = bodies.payload_mass if present is None else float(present[0])
    steps = round(_LOAD_SHARE * float(bodies.masses.sum()) / _LEAST_LOAD_STEP_KG)
    more_kg = max(steps * _LEAST_LOAD_STEP_KG, _LEAST_LOAD_STEP_KG)
    load_kg: Array = now_kg + more_kg * (np.arange(len(pose)) % 2).astype(np.float64)
    q, expected = stops.at(pose, approach, load_kg)
    design = CandidateDesign.of(hypothesis.data, hypothesis.fit, q, expected)
    loaded = _least(hypothesis.discriminations(design), np.arange(len(pose)))
    if loaded < _WORTH_A_LOAD * proposed:
        return []
    titles = " and ".join(EFFECTS[slug].title for slug in hypothesis.effects)
    aim = f"distinguish {titles}" if hypothesis.against else f"show {titles}"
    return [
        f"arm {stops.name}: another load would {aim} better: {now_kg + more_kg:g} kg instead of {now_kg:g} kg at every"
        f" second stop would bring the discrimination to {loaded:.0f} instead of {proposed:.0f}; a person"
        " must attach it, if the arm may carry it, and enter it in the controller"
    ]


DEFAULT_EFFORT = Effort()
"""Effort of a proposal from the command line: 10 stops for the two arms of the twin take some 5 s."""
_PROPOSAL_SEED = 0x9409
"""Seed, besides the profile's seed and the number of readings: a later proposal samples other candidates."""


@dataclass(frozen=True)
class Proposal:
    """Proposed stops in the order of measuring, and the discrimination that they are predicted to give.

    Attributes
    ----------
    stops : PlannedStops
        With straight motions; one at least.
    questions : mapping
        Arm -> what the stops decide of it.
    notes, advice : tuple of str
    """

    stops: PlannedStops
    questions: Mapping[str, tuple[ProposalQuestion, ...]]
    notes: tuple[str, ...]
    advice: tuple[str, ...]


def _unnamed_advice(name: str, unnamed: Unnamed | None) -> list[str]:
    """Name the likeliest causes of an arm's unnamed term, with the first thing that settles each."""
    if unnamed is None or not unnamed.in_force:
        return []
    place = place_in_words(unnamed.acts_on)
    causes = [
        f"{EFFECTS[cause].title} ({EFFECTS[cause].meaning.at(place).settle[0].rstrip('.')})"
        for cause in unnamed.causes
        if cause != UNKNOWN
    ]
    like = " or ".join(causes) or "nothing in the library: joints that depend on their neighbours, or a field"
    return [f"arm {name}: the unnamed term, mostly {place}, is most like {like}"]


def propose_stops(
    profile: Profile,
    model: CellModel,
    readings: Mapping[str, Readings],
    found: Mapping[str, ArmFound],
    count: int,
    job: JobToken = UNATTENDED,
    effort: Effort | None = None,
) -> Proposal:
    """Propose ``count`` further stops of all arms of a calibrated cell after ``found`` was discovered.

    Raises
    ------
    InputError
        If nothing is open, or no candidate stops can be made.
    Cancelled
        On request.
    """
    effort = effort or DEFAULT_EFFORT
    rng = np.random.default_rng([profile.seed, _PROPOSAL_SEED, max(len(arm) for arm in readings.values())])
    job.tell("propose", 0, count, "candidates")
    poses, notes = candidate_poses(profile, readings, effort, rng, job)
    asked = [
        open_questions(arm, model.arms, found[name], poses, count, rng)
        for name, arm in ArmReadings.of_cell(profile, model.arms, readings).items()
    ]
    if not any(hypotheses for _, hypotheses in asked):
        raise InputError("propose: no effect is ambiguous or hidden, so further stops have nothing to decide")
    poses = poses.first(min(_affordable_poses(*of_arm, effort.candidates) for of_arm in asked))
    arms = [
        ArmCandidates.of(replace(stops, poses=poses), hypotheses, np.array(profile.arms[stops.name].joint_limits))
        for stops, hypotheses in asked
    ]
    coupled = any(InputVariable.OTHER_ARM in _variables(hypotheses) for _, hypotheses in asked)
    chosen = StopSelection(arms, poses, coupled or poses.gate is None, rng).select(count, job)
    if not chosen:
        raise InputError("propose: the motion check refused all candidates; reduce plan.clearance, or move the bases")
    if len(chosen) < count:
        notes.append(f"only {len(chosen)} of {counted(count, 'stop')}: the motion check refused the other candidates")
    questions: dict[str, tuple[ProposalQuestion, ...]] = {}
    advice = [words for name in model.arms for words in _unnamed_advice(name, found[name].result.unnamed)]
    taken = {arm.stops.name: np.array([one[k] for one in chosen]).T for k, arm in enumerate(arms)}
    stops = straight_stops({name: poses.q[name][pose] for name, (pose, _) in taken.items()})
    stops.proposed[:] = True
    for arm, (name, (pose, approach)) in zip(arms, taken.items(), strict=True):
        of_arm, advice_of_arm = predict_arm(arm, pose, approach, rng)
        questions.update({name: tuple(of_arm)} if of_arm else {})
        advice += advice_of_arm
        stops.approach_from[name][:] = begin_of(stops.q[name], arm.stops.approaches.steps[pose, approach])
        stops.dwell_s[name][:] = arm.stops.approaches.dwells[approach]
    job.tell("propose", count, count, "done")
    return Proposal(stops, questions, tuple(notes), tuple(dict.fromkeys(advice)))


# -- Greedy choice of further stops for all arms, among candidates that the safety gate lets them reach ---------------
#
# Stop by stop, each arm takes the candidate of the largest gain (sequential T-optimal design). The arms can move to
# every stop from home, and home from it. The order is random, so that time is confounded with nothing.


_MOST_OFTEN = 3
"""How often a pose is proposed at most: optimal designs repeat few stops, which would hide
that a law is wrong elsewhere."""
_REFUSALS = 400
"""Refusals in a row after which the search for a further stop ends: bounds the time in a crowded cell."""


ChosenStop = tuple[tuple[int, int], ...]
"""Of each arm its pose, and the approach to it."""


@dataclass(eq=False)
class StopSelection:
    """The selection of stops for all arms.

    Attributes
    ----------
    arms, poses
        The candidates.
    paired : bool
        Keep poses of all arms together that were sampled together, as where an effect depends on the other arm. Else
        each arm's best poses are combined, if the gate accepts it.
    rng
    refused : set of ChosenStop
        Combinations that the gate refused.
    """

    arms: Sequence[ArmCandidates]
    poses: CandidatePoses
    paired: bool
    rng: np.random.Generator
    refused: set[ChosenStop] = field(default_factory=set)

    def select(self, count: int, job: JobToken) -> list[ChosenStop]:
        """Choose ``count`` stops, each the best in addition to those before; fewer if the gate refuses."""
        found: list[ChosenStop] = []
        while len(found) < count:
            job.check()
            job.tell("propose", len(found), count, "stops")
            stop = self._next(count - len(found))
            if stop is None:
                break
            for arm, candidate in zip(self.arms, stop, strict=True):
                arm.add(*candidate)
            found.append(stop)
        return [found[k] for k in self.rng.permutation(len(found))]

    def _next(self, stops: int) -> ChosenStop | None:
        """Choose the best stop whose last steps the gate accepts; None if there is none."""
        gains = [arm.gains(stops) for arm in self.arms]
        for _ in range(_REFUSALS):
            stop = self._best(gains)
            if stop is None:
                return None
            refused_arms = self._arms_refused_alone(stop)
            if not refused_arms and stop not in self.refused and not self._refused_together(stop):
                return stop
            self.refused.add(stop)
            for number in refused_arms:
                self.arms[number].allowed[stop[number]] = False
            for number in refused_arms or [_least_loss(gains, stop)]:
                gains[number][stop[number]] = -math.inf
        return None

    def _best(self, gains: Sequence[Array]) -> ChosenStop | None:
        """Return the stop of the largest gains (n, f) of each arm; None if an arm has no candidate left."""
        by_pose = [gain.max(axis=1) for gain in gains]
        if self.paired:
            by_pose = [np.sum(by_pose, axis=0)] * len(self.arms)
        poses = [int(np.argmax(best)) for best in by_pose]
        if any(not math.isfinite(float(best[pose])) for best, pose in zip(by_pose, poses, strict=True)):
            return None
        return tuple((pose, int(np.argmax(gain[pose]))) for gain, pose in zip(gains, poses, strict=True))

    def _last_motion(self, stop: ChosenStop) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return where the last steps to a stop begin, and the stop; an arm without a step is there already."""
        target = {arm.stops.name: self.poses.q[arm.stops.name][pose] for arm, (pose, _) in zip(self.arms, stop)}
        steps = [arm.stops.approaches.steps[one] for arm, one in zip(self.arms, stop, strict=True)]
        return {name: q - step for (name, q), step in zip(target.items(), steps, strict=True)}, target

    def _arms_refused_alone(self, stop: ChosenStop) -> list[int]:
        """Return indices of the arms whose last step the gate refuses whatever the others do."""
        gate = self.poses.gate
        if gate is None:
            return []
        start, target = self._last_motion(stop)
        return [
            number
            for number, name in enumerate(target)
            if not np.array_equal(start[name], target[name])
            and refuse_motion(replace(gate, arms={name: gate.arms[name]}), {name: start[name]}, {name: target[name]})
        ]

    def _refused_together(self, stop: ChosenStop) -> bool:
        """Return whether the tracker misses an SMR at a stop, or the gate refuses the last steps or the ways home."""
        gate, homes = self.poses.gate, self.poses.homes
        if gate is None:
            return False
        start, target = self._last_motion(stop)
        if not self.paired and not visible_stops(gate, {name: q[None] for name, q in target.items()})[0]:
            return True
        return bool(refuse_motion(gate, start, target)) or not (
            can_go(gate, homes, start) and can_go(gate, target, homes)
        )


def _least_loss(gains: Sequence[Array], stop: ChosenStop) -> int:
    """Return the index of the arm whose second best candidate is nearest to its best."""
    losses = []
    for gain, best in zip(gains, stop, strict=True):
        rest = gain.copy()
        rest[best] = -math.inf
        losses.append(float(gain[best] - rest.max()))
    return int(np.argmin(losses))


# -- Stops that discovery proposed, appended to the plan of a run that this program drives ----------------------------


def append_proposed_stops(run: RunFile, stops: PlannedStops) -> int:
    """Append stops to the plan in place of earlier proposals that were not measured; return the first one's number."""
    plan, done = read_planned_stops(run), run.stops_done()
    first = len(plan)
    while first and plan.proposed[first - 1] and first - 1 not in done:
        first -= 1
    whole = joined(plan.take(range(first)), stops)
    block = np.where(np.arange(len(whole)) < first, whole.block, whole.block[:first].max(initial=-1) + 1)
    load = np.where(np.arange(len(whole)) < first, whole.load, whole.load[:first].max(initial=0))  # the last load
    write_planned_stops(run, replace(whole, block=block, load=load))
    return first


def why_not_driven(run: RunFile) -> str:
    """Say why this program cannot drive further stops of a run; empty if it can."""
    missing = [f"arms.{name}" for name, arm in run.profile.arms.items() if not arm.driver.has_device]
    missing += [] if run.profile.tracker.driver.has_device else ["tracker"]
    if missing:
        return f"the driver of {missing[0]} is 'none'"
    return "" if run.read_plan() else "the run has no plan (it was imported)"
