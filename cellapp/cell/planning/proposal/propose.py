"""Proposal of further stops, and of how to approach them, that best decide what discovery left open."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.planned_stops import (
    PlannedStops,
    can_go,
    joined,
    read_planned_stops,
    straight_stops,
    write_planned_stops,
)
from cellapp.cell.planning.proposal.arm_candidates import (
    ArmCandidates,
    ArmHypotheses,
    CandidatePoses,
    Effort,
    alone,
    candidate_poses,
    last_known,
)
from cellapp.cell.planning.proposal.hypotheses import CandidateDesign, Hypothesis
from cellapp.cell.run import RunFile
from cellapp.cell.safety.gate import refuse_motion, visible_stops
from cellapp.estimation.calibration.quantities import conditions_of_arms
from cellapp.estimation.design.information import Discrimination
from cellapp.estimation.discovery.outcome import Discovery
from cellapp.estimation.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore
from cellapp.robot.effects import EFFECTS, DriverVariable, varies
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import CellModel

# -- Value of proposed stops: discrimination of each hypothesis now, with them, and with equally many random ones -----


_RANDOM_DESIGNS = 8
"""Number of random designs that are averaged for comparison, so that no single draw decides."""
_LOAD_SHARE = 0.25
"""Suggested further payload as a share of the arm's own mass: what arms of this class may carry."""
_LEAST_LOAD_STEP_KG = 0.5
"""Suggested payloads are multiples of this: common weights."""
_WORTH_A_LOAD = 1.5
"""Factor by which another payload must raise the discrimination to be suggested."""


@dataclass(frozen=True)
class PredictedDiscrimination:
    """Non-centrality lambda of one hypothesis: now, with the proposed stops, with the same number of random ones.

    ``against`` is empty where the question is whether the effect can be seen at all.
    """

    arm: str
    effect: str
    against: str
    needed: float
    now: float
    proposed: float
    random: float

    @property
    def gain_over_random(self) -> float:
        """Ratio of the discrimination with the proposed stops to that with random ones."""
        return self.proposed / max(self.random, 1e-12)


def predict_arm(
    arm: ArmCandidates,
    poses: CandidatePoses,
    pose: NDArray[np.intp],
    approach: NDArray[np.intp],
    rng: np.random.Generator,
) -> tuple[list[PredictedDiscrimination], list[str]]:
    """Predict the hypotheses of one arm with the chosen candidates; return also advice to change its payload."""
    chosen = pose * len(arm.approaches) + approach
    draws = [rng.integers(0, len(poses) * len(arm.approaches), len(chosen)) for _ in range(_RANDOM_DESIGNS)]
    nothing = np.array([], dtype=np.intp)
    predictions, advice = [], []
    for one, comparison in arm.comparisons:
        prediction = PredictedDiscrimination(
            arm=arm.name,
            effect=one.effect,
            against=one.against,
            needed=one.needed,
            now=_least(comparison, nothing),
            proposed=_least(comparison, chosen),
            random=float(np.mean([_least(comparison, draw) for draw in draws])),
        )
        predictions.append(prediction)
        advice += _load_advice(arm, one, poses, pose, approach, prediction)
    return predictions, advice


def _least(comparison: Sequence[Discrimination], chosen: NDArray[np.intp]) -> float:
    """Return the least discrimination over the laws of the rival."""
    return min(one.noncentrality(chosen) for one in comparison)


def _load_advice(
    arm: ArmCandidates,
    hypothesis: Hypothesis,
    poses: CandidatePoses,
    pose: NDArray[np.intp],
    approach: NDArray[np.intp],
    prediction: PredictedDiscrimination,
) -> list[str]:
    """Advise another payload at every second stop, if the stops do not decide and the run had one payload."""
    conditions = arm.run.conditions
    depends = any(DriverVariable.PAYLOAD in EFFECTS[slug].variables for slug in hypothesis.effects)
    decided = bool(hypothesis.against) and prediction.proposed >= prediction.needed
    if not depends or decided or varies(conditions.payload_kg):
        return []
    bodies = hypothesis.data.model.bodies
    present = last_known(conditions.payload_kg, 1)
    now_kg = bodies.payload_mass if present is None else float(present[0])
    steps = round(_LOAD_SHARE * float(bodies.masses.sum()) / _LEAST_LOAD_STEP_KG)
    more_kg = max(steps * _LEAST_LOAD_STEP_KG, _LEAST_LOAD_STEP_KG)
    load_kg: Array = now_kg + more_kg * (np.arange(len(pose)) % 2).astype(np.float64)
    q, expected = arm.run.candidates(poses, arm.approaches, pose, approach, load_kg)
    design = CandidateDesign.of(hypothesis.data, hypothesis.fit, q, expected)
    loaded = _least(hypothesis.discriminations(design), np.arange(len(pose)))
    if loaded < _WORTH_A_LOAD * prediction.proposed:
        return []
    titles = " and ".join(EFFECTS[slug].title for slug in hypothesis.effects)
    aim = f"distinguish {titles}" if hypothesis.against else f"show {titles}"
    return [
        f"arm {arm.name}: another load would {aim} better: {now_kg + more_kg:g} kg instead of {now_kg:g} kg at every"
        f" second stop would bring the discrimination to {loaded:.0f} instead of {prediction.proposed:.0f}; a person"
        " must attach it, if the arm may carry it, and enter it in the controller"
    ]


DEFAULT_EFFORT = Effort()
"""Effort of a proposal from the command line: 10 stops for the two arms of the twin take some 5 s."""
_PROPOSAL_SEED = 0x9409
"""Seed, besides the profile's seed and the number of readings: a later proposal draws other candidates."""


@dataclass(frozen=True)
class Proposal:
    """Proposed stops in the order of measuring, and the discrimination that they are predicted to give.

    Attributes
    ----------
    stops : PlannedStops
        With straight motions; one at least.
    predictions : tuple of PredictedDiscrimination
    notes, advice : tuple of str
    """

    stops: PlannedStops
    predictions: tuple[PredictedDiscrimination, ...]
    notes: tuple[str, ...]
    advice: tuple[str, ...]


def propose_stops(
    profile: Profile,
    model: CellModel,
    readings: Mapping[str, Readings],
    found: Mapping[str, Discovery],
    count: int,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
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
    cancel, effort = cancel or CancelToken(), effort or DEFAULT_EFFORT
    rng = np.random.default_rng([profile.seed, _PROPOSAL_SEED, max(len(arm) for arm in readings.values())])
    listener(Progress("propose", 0, count, "candidates"))
    poses, notes = candidate_poses(profile, readings, effort, rng, cancel)
    conditions = conditions_of_arms(model.arms, readings)
    hypotheses = [
        ArmHypotheses.of(profile, name, model, readings[name], conditions[name], found[name], poses, count, effort, rng)
        for name in model.arms
    ]
    if not any(arm.hypotheses for arm in hypotheses):
        raise InputError("propose: no effect is ambiguous or hidden, so further stops have nothing to decide")
    poses = poses.first(min(arm.affordable_poses for arm in hypotheses))
    arms = [ArmCandidates.of(arm, poses) for arm in hypotheses]
    coupled = any(DriverVariable.OTHER_ARM in arm.variables for arm in hypotheses)
    selection = StopSelection(arms, poses, coupled or poses.gate is None, rng)
    chosen = selection.select(count, listener, cancel)
    if not chosen:
        raise InputError("propose: the gate refused every candidate; make plan.clearance smaller, or move the bases")
    if len(chosen) < count:
        notes.append(f"only {len(chosen)} of {counted(count, 'stop')}: the gate refused the other candidates")
    predictions: list[PredictedDiscrimination] = []
    advice: list[str] = []
    taken = {arm.name: np.array([one.poses[k] for one in chosen], dtype=np.intp) for k, arm in enumerate(arms)}
    stops = straight_stops({name: poses.q[name][pose] for name, pose in taken.items()})
    stops.proposed[:] = True
    for number, arm in enumerate(arms):
        pose = taken[arm.name]
        approach = np.array([one.approaches[number] for one in chosen], dtype=np.intp)
        of_arm, advice_of_arm = predict_arm(arm, poses, pose, approach, rng)
        predictions += of_arm
        advice += advice_of_arm
        step = arm.approaches.steps[pose, approach]
        moved = step.any(axis=1)
        stops.approach_from[arm.name][moved] = (stops.q[arm.name] - step)[moved]
        stops.dwell_s[arm.name][:] = arm.approaches.dwells[approach]
    listener(Progress("propose", count, count, "done"))
    return Proposal(stops, tuple(predictions), tuple(notes), tuple(dict.fromkeys(advice)))


# -- Greedy choice of further stops for all arms, among candidates that the safety gate lets them reach ---------------
#
# Stop by stop, each arm takes the candidate of the largest gain (sequential T-optimal design). The arms can move to
# every stop from home, and home from it. The order is random, so that time is confounded with nothing.


_MOST_OFTEN = 3
"""How often a pose is proposed at most: optimal designs repeat few stops, which would hide
that a law is wrong elsewhere."""
_REFUSALS = 400
"""Refusals in a row after which the search for a further stop ends: bounds the time in a crowded cell."""


@dataclass(frozen=True)
class ChosenStop:
    """The pose of each arm, and the approach to it."""

    poses: tuple[int, ...]
    approaches: tuple[int, ...]


@dataclass(eq=False)
class StopSelection:
    """The selection of stops for all arms.

    Attributes
    ----------
    arms, poses
        The candidates.
    paired : bool
        Keep poses of all arms together that were drawn together, as where an effect depends on the other arm. Else
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

    def select(self, count: int, listener: Listener, cancel: CancelToken) -> list[ChosenStop]:
        """Choose ``count`` stops, each the best in addition to those before; fewer if the gate refuses."""
        used = [np.zeros(len(self.poses), dtype=np.intp) for _ in self.arms]
        found: list[ChosenStop] = []
        while len(found) < count:
            cancel.check()
            listener(Progress("propose", len(found), count, "stops"))
            stop = self._next(used, count - len(found))
            if stop is None:
                break
            for arm, counts, pose, approach in zip(self.arms, used, stop.poses, stop.approaches, strict=True):
                arm.add(pose, approach)
                counts[pose] += 1
            found.append(stop)
        return [found[k] for k in self.rng.permutation(len(found))]

    def target(self, stop: ChosenStop) -> dict[str, Array]:
        """Return the joint positions of the arms at a stop."""
        return {arm.name: self.poses.q[arm.name][pose] for arm, pose in zip(self.arms, stop.poses, strict=True)}

    def _next(self, used: list[NDArray[np.intp]], stops_left: int) -> ChosenStop | None:
        """Choose the best stop whose last steps the gate accepts; None if there is none."""
        gains = [arm.gains(stops_left) for arm in self.arms]
        for gain, counts in zip(gains, used, strict=True):
            gain[counts >= _MOST_OFTEN] = -math.inf
        for _ in range(_REFUSALS):
            stop = self._best(gains)
            if stop is None:
                return None
            refused_arms = self._arms_refused_alone(stop)
            if not refused_arms and stop not in self.refused and not self._refused_together(stop):
                return stop
            self.refused.add(stop)
            for number in refused_arms:
                self.arms[number].allowed[stop.poses[number], stop.approaches[number]] = False
            for number in refused_arms or [_least_loss(gains, stop)]:
                gains[number][stop.poses[number], stop.approaches[number]] = -math.inf
        return None

    def _best(self, gains: Sequence[Array]) -> ChosenStop | None:
        """Return the stop of the largest gains (n, f) of each arm; None if an arm has no candidate left."""
        by_pose = [gain.max(axis=1) for gain in gains]
        if self.paired:
            by_pose = [np.sum(by_pose, axis=0)] * len(self.arms)
        poses = tuple(int(np.argmax(best)) for best in by_pose)
        if any(not math.isfinite(float(best[pose])) for best, pose in zip(by_pose, poses, strict=True)):
            return None
        return ChosenStop(poses, tuple(int(np.argmax(gain[pose])) for gain, pose in zip(gains, poses, strict=True)))

    def _start(self, stop: ChosenStop) -> dict[str, Array]:
        """Return where the last steps to a stop begin; an arm without one is there already."""
        starts = self.target(stop)
        for arm, pose, approach in zip(self.arms, stop.poses, stop.approaches, strict=True):
            start = arm.start_of_last_step(self.poses, pose, approach)
            if start is not None:
                starts[arm.name] = start
        return starts

    def _arms_refused_alone(self, stop: ChosenStop) -> list[int]:
        """Return indices of the arms whose last step the gate refuses whatever the others do."""
        gate = self.poses.gate
        if gate is None:
            return []
        target, start = self.target(stop), self._start(stop)
        return [
            number
            for number, arm in enumerate(self.arms)
            if start[arm.name] is not target[arm.name]
            and refuse_motion(alone(gate, arm.name), {arm.name: start[arm.name]}, {arm.name: target[arm.name]})
        ]

    def _refused_together(self, stop: ChosenStop) -> bool:
        """Return whether the tracker misses an SMR at a stop, or the gate refuses the last steps or the ways home."""
        gate, homes = self.poses.gate, self.poses.homes
        if gate is None:
            return False
        start, target = self._start(stop), self.target(stop)
        if not self.paired and not visible_stops(gate, {name: q[None] for name, q in target.items()})[0]:
            return True
        return bool(refuse_motion(gate, start, target)) or not (
            can_go(gate, homes, start) and can_go(gate, target, homes)
        )


def _least_loss(gains: Sequence[Array], stop: ChosenStop) -> int:
    """Return the index of the arm whose second best candidate is nearest to its best."""
    losses = []
    for gain, pose, approach in zip(gains, stop.poses, stop.approaches, strict=True):
        rest = gain.copy()
        rest[pose, approach] = -math.inf
        losses.append(float(gain[pose, approach] - rest.max()))
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
