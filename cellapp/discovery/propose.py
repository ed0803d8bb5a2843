"""Proposed stops (``discover --propose N``): which stops, and how approached, best resolve what is ambiguous."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from cellapp.calibration.circumstances import base_moment
from cellapp.design.discrimination import Contest, Race
from cellapp.discovery.data import ArmData, Fit
from cellapp.discovery.discover import CellDiscovery, Discovery, known_of_all
from cellapp.discovery.questions import Question, There, fitted, questions
from cellapp.effects import EFFECTS, Circumstances, varies
from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel, CellModel
from cellapp.planning.plan import all_seen, draw_stops, rolled_stops
from cellapp.planning.stop_conditions import StopConditions
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.run import Readings
from cellapp.safety.cell_bodies import cell_bodies, home_positions
from cellapp.safety.gate import CellBodies, refuse_motion

_DRAWN = 280
_POSES = 200
_HUBS = 7
_FREE_WAYS = 3
_ROLLS = 2
STEPS_RAD = (0.03, 0.5)
"""Small and large last steps of a joint."""
DWELLS_S = (0.5, 5.0)
"""Short and long rests before a measurement."""
_MOST_OFTEN = 3
"""A posture, whatever its wrist roll, is proposed at most so often: designs like repetition, wrong laws do not."""
_REFUSALS = 400
"""Gate refusals in a row after which no further stop is looked for."""
_ROUNDS = 4
"""Of choosing stops in place of those that could not be reached."""
_DRAWS = 8
_HOPELESS = 0.02
"""A question that all stops together would bring on by less than this share of what it needs is left aside."""
_WORST_FIRST = 3.0
_MEMORY = 3e8
"""For the candidates' columns [bytes]."""
_MOST_CANDIDATES = 8000
"""Of one arm: poses times ways of coming to them."""
_LOAD_SHARE = 0.25
"""Of an arm's own mass: a load that arms of this class may carry."""
_WORTH_A_LOAD = 1.5
_TYPICAL_DWELL_S = 0.7


@dataclass(frozen=True)
class Answer:
    """One question of one arm: the discrimination (lambda) now, with the proposed stops, and with as many random ones.

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
    def gain(self) -> float:
        """How many times the discrimination with random stops the proposed ones give."""
        return self.proposed / max(self.random, 1e-12)


@dataclass(frozen=True)
class ProposedStop:
    """Where the arms stand, arm -> (N,) [rad], and how they come there."""

    q: Mapping[str, Array]
    factors: Mapping[str, StopConditions]


@dataclass(frozen=True)
class Proposal:
    """The stops in the order of measuring, and what they are worth."""

    stops: tuple[ProposedStop, ...]
    answers: tuple[Answer, ...]
    notes: tuple[str, ...]
    advice: tuple[str, ...]


def propose(
    profile: Profile,
    readings: Mapping[str, Readings],
    found: CellDiscovery,
    count: int,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> Proposal:
    """Propose ``count`` further stops of all arms after a discovery.

    Raises
    ------
    InputError
        If there is nothing that further stops could resolve, or no candidate stops can be made.
    Cancelled
    """
    cancel = cancel or CancelToken()
    model = found.model
    rng = np.random.default_rng([profile.seed, 0x9409, max(len(arm) for arm in readings.values())])
    listener(Progress("propose", 0, count, "candidates"))
    poses, notes = _poses(profile, readings, rng, cancel)
    known = known_of_all(model, readings)
    asking = {
        name: _Asking.of(profile, name, model, readings, known[name], found.arms[name], poses, count, rng)
        for name in model.arms
    }
    if not any(asked.questions for asked in asking.values()):
        raise InputError("propose: there is nothing that further stops could tell: no effect is ambiguous or hidden")
    poses = poses.first(min(asked.affordable for asked in asking.values()))
    for asked in asking.values():
        asked.prepare(poses)
    variables = frozenset[str]().union(*(asked.variables for arm in asking.values() for asked in arm.questions))
    choice = _Choice(list(asking.values()), poses, "other_arm" in variables or poses.gate is None, rng)
    chosen = choice.select(count, listener, cancel)
    if not chosen:
        raise InputError("propose: the gate refused every candidate; make plan.clearance smaller, or move the bases")
    if len(chosen) < count:
        notes.append(f"only {len(chosen)} of {count} stops: the gate refused the other candidates")
    answers, advice = _answers(list(asking.values()), poses, chosen, rng)
    stops = tuple(ProposedStop(choice.target(one), choice.factors(one)) for one in chosen)
    listener(Progress("propose", count, count, "done"))
    return Proposal(stops, answers, tuple(notes), advice)


# -- candidates -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Poses:
    """Stops of all arms, name -> (n, N), and which are the same but for wrist rolls; ``gate`` None is no gate."""

    q: Mapping[str, Array]
    posture: NDArray[np.intp]
    gate: CellBodies | None
    homes: Mapping[str, Array]

    def __len__(self) -> int:
        return len(self.posture)

    def first(self, count: int) -> _Poses:
        """The first so many."""
        if count >= len(self):
            return self
        return replace(self, q={name: q[:count] for name, q in self.q.items()}, posture=self.posture[:count])


def _poses(
    profile: Profile, readings: Mapping[str, Readings], rng: np.random.Generator, cancel: CancelToken
) -> tuple[_Poses, list[str]]:
    """Candidates that are seen and safe; those that were measured where the profile does not say what that is."""
    described = profile.tracker.pose is not None and all(
        arm.base is not None and arm.home is not None and arm.type.capsules for arm in profile.arms.values()
    )
    if described:
        gate = cell_bodies(profile)
        homes = home_positions(profile)
        drawn = draw_stops(gate, profile, _DRAWN, rng, cancel)
        near = np.all([_easily_reached(gate, name, q, homes[name]) for name, q in drawn.items()], axis=0)
        if not near.any():
            raise InputError("propose: no candidate can be reached on a straight way; make plan.clearance smaller")
        drawn = {name: rows[near][:_POSES] for name, rows in drawn.items()}
        q, posture = rolled_stops(gate, drawn, _ROLLS, rng)
        mixed = rng.permutation(len(posture))
        q = {name: rows[mixed] for name, rows in q.items()}
        return _Poses(q, posture[mixed], gate, homes), []
    common = set.intersection(*(set(arm.configuration.tolist()) for arm in readings.values()))
    numbers = rng.permutation(np.array(sorted(common), dtype=np.int64))[: _POSES * (1 + _ROLLS)]
    if not len(numbers):
        raise InputError("propose: the arms have no stop in common from which candidates could be made")
    q = {}
    for name, arm in readings.items():
        row_of = {number: row for row, number in enumerate(arm.configuration.tolist())}
        q[name] = arm.q[[row_of[number] for number in numbers.tolist()]]
    note = (
        "candidates are configurations that were measured, as the profile does not say where arms and tracker stand;"
        " no collision was looked for on the way to them"
    )
    return _Poses(q, np.arange(len(numbers)), None, {}), [note]


def _easily_reached(gate: CellBodies, name: str, q: Array, home: Array) -> Array:
    """Which of the configurations (n, N) an arm that is alone can go straight to from some others, (n,) bool.

    What stands apart from all others (just above the floor, folded up) says much and is hardly ever come by.
    """
    alone = _alone(gate, name)
    reached = np.zeros(len(q), dtype=bool)
    for k, one in enumerate(q):
        free = 0
        for hub in (home, *q[[(k + 1 + i) % len(q) for i in range(min(_HUBS, len(q) - 1))]]):
            free += not refuse_motion(alone, {name: hub}, {name: one})
            if free >= _FREE_WAYS:
                reached[k] = True
                break
    return reached


# -- what each arm asks -----------------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Asking:
    """One arm: its questions, and for each pose the ways of coming to it (ways differ in last steps and dwell).

    ``steps`` (n, f, N) are last steps [rad], zero where none is asked for, ``dwells`` (f,) [s]; ``allowed`` (n, f).
    ``worth`` says how much each candidate brings on the questions, as ``races`` stand.
    """

    name: str
    model: ArmModel
    other: ArmModel | None
    readings: Readings
    known: Circumstances
    questions: list[Question]
    data: ArmData
    fit: Fit
    limits: Array
    steps: Array
    dwells: Array
    count: int
    affordable: int
    allowed: NDArray[np.bool_]
    contests: list[tuple[Question, list[Contest]]] = field(default_factory=list)
    races: list[tuple[Question, Race]] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        profile: Profile,
        name: str,
        model: CellModel,
        readings: Mapping[str, Readings],
        known: Circumstances,
        discovery: Discovery,
        poses: _Poses,
        count: int,
        rng: np.random.Generator,
    ) -> _Asking:
        own, arm = readings[name], profile.arms[name]
        rows = np.concatenate([own.in_split("identify"), own.in_split("train")])
        terms = [finding.term for finding in discovery.findings]
        bare = ArmData.of(profile, model.arms[name], own.take(rows), known.take(rows))
        data, fit = fitted(bare, terms, discovery.scatter)
        others = [other for other in model.arms if other != name]
        n, joints = len(poses), own.joints
        asking = cls(
            name=name,
            model=model.arms[name],
            other=model.arms[others[0]] if len(others) == 1 else None,
            readings=own,
            known=known,
            questions=[],
            data=data,
            fit=fit,
            limits=np.array(arm.limits or tuple(joint.limit for joint in arm.type.joints)),
            steps=_last_steps(n, joints, rng),
            dwells=np.zeros(0),
            count=count,
            affordable=n,
            allowed=np.ones((n, 1), dtype=bool),
        )
        asking._with_dwells()
        asking.questions = questions(data, fit, discovery, asking.sample(poses))
        asking._without_needless()
        width = sum(
            (len(asked.fit.rows) + sum(len(names) for _, names in asked.rivals)) * max(len(asked.rivals), 1)
            for asked in asking.questions
        )
        # each contest keeps its columns twice
        affordable = min(int(_MEMORY / max(2 * width * 24, 1)), _MOST_CANDIDATES) // asking.ways
        asking.affordable = max(20, affordable)
        return asking

    @property
    def ways(self) -> int:
        """Ways of coming to each pose."""
        return self.steps.shape[1]

    def _with_dwells(self) -> None:
        """Each last step with each dwell."""
        self.dwells = np.tile(np.array(DWELLS_S), self.steps.shape[1])
        self.steps = np.repeat(self.steps, len(DWELLS_S), axis=1)

    def _without_needless(self) -> None:
        """Neither detours nor pauses where nothing that is asked depends on them."""
        variables = frozenset[str]().union(*(asked.variables for asked in self.questions))
        if "dwell" not in variables:
            self.steps, self.dwells = self.steps[:, :: len(DWELLS_S)], np.zeros(self.ways // len(DWELLS_S))
        if not variables & {"approach", "step"}:
            dwells = np.unique(self.dwells)
            self.steps, self.dwells = np.zeros((len(self.steps), len(dwells), self.steps.shape[2])), dwells

    def sample(self, poses: _Poses) -> tuple[Array, Circumstances]:
        """Configurations (n f, N) and circumstances of all candidates, pose by pose."""
        pose, way = (each.ravel() for each in np.indices((len(poses), self.ways)))
        return self.of_candidates(poses, pose, way)

    def of_candidates(
        self, poses: _Poses, pose: NDArray[np.intp], way: NDArray[np.intp], load_kg: Array | None = None
    ) -> tuple[Array, Circumstances]:
        """Configurations and circumstances of some candidates; ``load_kg`` in place of what the arm carries."""
        q, m, known = poses.q[self.name][pose], len(pose), self.known
        steps = self.steps[pose, way]
        moment = other_q = None
        theirs = next((name for name in poses.q if name != self.name), None)
        if self.other is not None and theirs is not None:
            other_q = poses.q[theirs][pose]
            moment = base_moment(self.other, other_q)
        asked = bool(steps.any())
        dwell_s = None if known.dwell_s is None and not self.dwells.any() else self.dwells[way] + self._pause_s()
        payload = _last(known.payload_kg, m) if load_kg is None else load_kg
        return q, Circumstances(
            approach=np.sign(steps) if asked else None,
            step=steps if asked else None,
            dwell_s=dwell_s,
            time_s=self._times(m),
            payload_kg=payload,
            air_c=_last(known.air_c, m),
            joints_c=_last(known.joints_c, m),
            other_moment_M=moment,
            other_q=other_q,
            record=known.record,
        )

    def _pause_s(self) -> float:
        """How long the arm rests before it is measured where nobody asks for more."""
        dwell_s = self.known.dwell_s
        if dwell_s is None or not np.isfinite(dwell_s).any():
            return _TYPICAL_DWELL_S
        return float(np.nanmin(dwell_s))

    def _times(self, m: int) -> Array | None:
        """The middle of the time in which the further stops will be measured, at the pace of the run."""
        time_s = self.known.time_s
        if time_s is None or not np.isfinite(time_s).any():
            return None
        ordered = np.sort(time_s[np.isfinite(time_s)])
        pace = float(np.median(np.diff(ordered))) if len(ordered) > 1 else 0.0
        return np.full(m, float(ordered[-1]) + pace * (0.5 * self.count + 1.0))

    def prepare(self, poses: _Poses) -> None:
        """Set up the contests over all candidates, whose ways must stay inside the joint limits."""
        n = len(poses)
        self.steps = self.steps[:n]
        vias = poses.q[self.name][:, None] - self.steps
        low, high = self.limits.T
        self.allowed = ((vias >= low) & (vias <= high)).all(axis=2)
        q, known = self.sample(poses)
        seen: dict[int, There] = {}
        for asked in self.questions:
            if id(asked.fit) not in seen:
                seen[id(asked.fit)] = There.of(asked.data, asked.fit, q, known)
            self.contests.append((asked, self._open(asked, asked.contests(seen[id(asked.fit)]))))

    def _open(self, asked: Question, contests: list[Contest]) -> list[Contest]:
        """Without the laws that hold the effect itself (dry friction is backlash), unless they are all there is."""
        open_ones = []
        for contest in contests:
            race = contest.begin()
            most = race.value + self.count * float(race.gains().max(initial=0.0))
            if most > _HOPELESS * asked.needed:
                open_ones.append(contest)
        return open_ones or contests

    def restart(self, taken: Iterable[tuple[int, int]]) -> None:
        """Begin the contests anew with some candidates measured."""
        self.races = [(asked, contest.begin()) for asked, contests in self.contests for contest in contests]
        for pose, way in taken:
            self.take(pose, way)

    def worth(self, left: int) -> Array:
        """How much each candidate (n, f) brings on the questions, those that are worst off first; -inf where banned."""
        total = np.zeros(self.allowed.size)
        gains = [race.gains() / asked.needed for asked, race in self.races]
        stands = [race.value / asked.needed for asked, race in self.races]
        hopeful = [k for k, gain in enumerate(gains) if left * float(gain.max()) > _HOPELESS * max(1.0, stands[k])]
        if hopeful:
            worst = min(stands[k] for k in hopeful)
            for k in hopeful:
                total += gains[k] * ((stands[k] + 1e-3) / (worst + 1e-3)) ** -_WORST_FIRST
        else:
            total += np.sum(gains, axis=0) if gains else 0.0
        if total.max(initial=0.0) > 0.0:
            total = total / total.max()
        return np.where(self.allowed, total.reshape(self.allowed.shape), -math.inf)

    def take(self, pose: int, way: int) -> None:
        """Measure a candidate."""
        for _, race in self.races:
            race.take(pose * self.ways + way)
        self.allowed[pose, way] = False

    def factors(self, poses: _Poses, pose: int, way: int) -> StopConditions:
        """What the collection is asked for."""
        step = self.steps[pose, way]
        via = poses.q[self.name][pose] - step if step.any() else None
        return StopConditions(via, float(self.dwells[way]))


def _last(values: Array | None, m: int) -> Array | None:
    """What was last known, for m stops; temperatures as their mean over the last readings."""
    if values is None:
        return None
    rows = values[np.isfinite(values).reshape(len(values), -1).all(axis=1)]
    if not len(rows):
        return None
    return np.repeat(rows[-5:].mean(axis=0, keepdims=True) if values.ndim > 1 else rows[-1:], m, axis=0)


def _last_steps(n: int, joints: int, rng: np.random.Generator) -> Array:
    """Last steps (n, 12, N) [rad]: all joints forward, all backward, two mixtures; small, large and mixed in size."""
    mixed = rng.choice([-1.0, 1.0], (n, 1, joints))
    signs = np.concatenate([np.ones((n, 1, joints)), -np.ones((n, 1, joints)), mixed, -mixed], axis=1)
    small, large = STEPS_RAD
    sizes = (np.full((n, 4, joints), small), np.full((n, 4, joints), large), rng.choice(STEPS_RAD, (n, 4, joints)))
    return np.concatenate([signs * size for size in sizes], axis=1)


# -- the choice -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Chosen:
    """The pose of each arm, and the way of coming to it."""

    poses: tuple[int, ...]
    ways: tuple[int, ...]


@dataclass(eq=False)
class _Choice:
    """Choosing stops for all arms. ``paired`` keeps the poses together that were drawn together, as it must be where
    anything depends on the other arm; else each arm's best poses meet, if they may."""

    arms: list[_Asking]
    poses: _Poses
    paired: bool
    rng: np.random.Generator
    refused: set[_Chosen] = field(default_factory=set)
    free: dict[tuple[_Chosen | None, _Chosen | None], bool] = field(default_factory=dict)

    def select(self, count: int, listener: Listener, cancel: CancelToken) -> list[_Chosen]:
        """``count`` stops in an order in which each can be reached from the one before; fewer if the gate says so."""
        kept: list[_Chosen] = []
        for _ in range(_ROUNDS):
            for number, arm in enumerate(self.arms):
                arm.restart(zip((one.poses[number] for one in kept), (one.ways[number] for one in kept), strict=True))
            before = len(kept)
            kept = self._ordered([*kept, *self._further(kept, count, listener, cancel)])
            if len(kept) == count or len(kept) == before:
                break
        return kept

    def _further(self, kept: Sequence[_Chosen], count: int, listener: Listener, cancel: CancelToken) -> list[_Chosen]:
        """Stop after stop the one that brings on the questions of all arms most."""
        used = [np.zeros(int(self.poses.posture.max()) + 1, dtype=np.intp) for _ in self.arms]
        for earlier in kept:
            self._use(used, earlier)
        found: list[_Chosen] = []
        while len(kept) + len(found) < count:
            cancel.check()
            listener(Progress("propose", len(kept) + len(found), count, "stops"))
            one = self._next(used, count - len(kept) - len(found))
            if one is None:
                break
            for arm, pose, way in zip(self.arms, one.poses, one.ways, strict=True):
                arm.take(pose, way)
            self._use(used, one)
            found.append(one)
        return found

    def _use(self, used: list[NDArray[np.intp]], one: _Chosen) -> None:
        for counts, pose in zip(used, one.poses, strict=True):
            counts[self.poses.posture[pose]] += 1

    def _next(self, used: list[NDArray[np.intp]], left: int) -> _Chosen | None:
        """The best stop that the gate lets the arms come to."""
        worths = [arm.worth(left) for arm in self.arms]
        for worth, counts in zip(worths, used, strict=True):
            worth[counts[self.poses.posture] >= _MOST_OFTEN] = -math.inf
        for _ in range(_REFUSALS):
            by_pose = [worth.max(axis=1) for worth in worths]
            if self.paired:
                by_pose = [np.sum(by_pose, axis=0)] * len(self.arms)
            picked = tuple(int(np.argmax(best)) for best in by_pose)
            if any(not math.isfinite(float(best[pose])) for best, pose in zip(by_pose, picked, strict=True)):
                return None
            ways = tuple(int(np.argmax(worth[pose])) for worth, pose in zip(worths, picked, strict=True))
            one = _Chosen(picked, ways)
            alone = self._refused_alone(one)
            if not alone and one not in self.refused and not self._refused_together(one):
                return one
            self.refused.add(one)
            for number in alone:
                self.arms[number].allowed[one.poses[number], one.ways[number]] = False
            for number in alone or [self._who_gives_way(worths, one)]:
                worths[number][one.poses[number], one.ways[number]] = -math.inf
        return None

    @staticmethod
    def _who_gives_way(worths: Sequence[Array], one: _Chosen) -> int:
        """The arm whose next best candidate is nearest to its best."""
        costs = []
        for number, worth in enumerate(worths):
            rest = worth.copy()
            rest[one.poses[number], one.ways[number]] = -math.inf
            costs.append(float(worth[one.poses[number], one.ways[number]] - rest.max()))
        return int(np.argmin(costs))

    # -- the gate --

    def target(self, one: _Chosen) -> dict[str, Array]:
        """Where the arms stand."""
        return {arm.name: self.poses.q[arm.name][pose] for arm, pose in zip(self.arms, one.poses, strict=True)}

    def factors(self, one: _Chosen) -> dict[str, StopConditions]:
        """How they come there."""
        ways = zip(self.arms, one.poses, one.ways, strict=True)
        return {arm.name: arm.factors(self.poses, pose, way) for arm, pose, way in ways}

    def start(self, one: _Chosen) -> dict[str, Array]:
        """Where the last leg begins; an arm without one is already there."""
        vias = {name: asked.via for name, asked in self.factors(one).items() if asked.via is not None}
        return {**self.target(one), **vias}

    def _refused_alone(self, one: _Chosen) -> list[int]:
        """The arms whose last leg the gate refuses whatever the others do."""
        if self.poses.gate is None:
            return []
        there, start = self.target(one), self.start(one)
        return [
            number
            for number, arm in enumerate(self.arms)
            if start[arm.name] is not there[arm.name]
            and refuse_motion(_alone(self.poses.gate, arm.name), _only(start, arm.name), _only(there, arm.name))
        ]

    def _refused_together(self, one: _Chosen) -> bool:
        if self.poses.gate is None:
            return False
        there = self.target(one)
        if not self.paired and not all_seen(self.poses.gate, there):
            return True
        return bool(refuse_motion(self.poses.gate, self.start(one), there))

    def _ordered(self, chosen: Sequence[_Chosen]) -> list[_Chosen]:
        """In random order, so that time is tied to nothing, as far as each stop can be reached from the one before.

        Stops that fit nowhere are left out.
        """
        waiting = [chosen[k] for k in self.rng.permutation(len(chosen))]
        if self.poses.gate is None:
            return waiting
        path: list[_Chosen] = []
        grown = True
        while waiting and grown:
            grown = False
            for one in list(waiting):
                for place in self.rng.permutation(len(path) + 1).tolist():
                    before = path[place - 1] if place else None
                    after = path[place] if place < len(path) else None
                    if self._reachable(before, one) and self._reachable(one, after):
                        path.insert(place, one)
                        waiting.remove(one)
                        grown = True
                        break
        self.refused.update(waiting)
        return path

    def _reachable(self, before: _Chosen | None, after: _Chosen | None) -> bool:
        """Whether the arms can go from one stop to where the last leg to another begins; None is home.

        As the collection does: all at once, or one after the other.
        """
        if (before, after) not in self.free:
            gate = self.poses.gate
            assert gate is not None
            here = self.poses.homes if before is None else self.target(before)
            there = self.poses.homes if after is None else self.start(after)
            self.free[before, after] = _may_go(gate, here, there)
        return self.free[before, after]


def _may_go(gate: CellBodies, here: Mapping[str, Array], there: Mapping[str, Array]) -> bool:
    if not refuse_motion(gate, here, there):
        return True
    for order in permutations(there):
        now = dict(here)
        for name in order:
            then = {**now, name: there[name]}
            if refuse_motion(gate, now, then):
                break
            now = then
        else:
            return True
    return False


def _alone(gate: CellBodies, name: str) -> CellBodies:
    """The cell with one arm only."""
    return replace(gate, arms={name: gate.arms[name]})


def _only(q: Mapping[str, Array], name: str) -> dict[str, Array]:
    return {name: q[name]}


# -- what it is worth -------------------------------------------------------------------------------------------------


def _answers(
    arms: Sequence[_Asking], poses: _Poses, chosen: Sequence[_Chosen], rng: np.random.Generator
) -> tuple[tuple[Answer, ...], tuple[str, ...]]:
    """Discrimination of each question now, with the chosen stops, and with as many random ones (mean of some draws)."""
    answers, advice = [], []
    for number, arm in enumerate(arms):
        picked = np.array([one.poses[number] * arm.ways + one.ways[number] for one in chosen], dtype=np.intp)
        draws = [rng.integers(0, len(poses) * arm.ways, len(chosen)) for _ in range(_DRAWS)]
        nothing = np.array([], dtype=np.intp)
        for asked, contests in arm.contests:
            answer = Answer(
                arm=arm.name,
                effect=asked.effect,
                against=asked.against,
                needed=asked.needed,
                now=min(contest.discrimination(nothing) for contest in contests),
                proposed=min(contest.discrimination(picked) for contest in contests),
                random=float(np.mean([min(c.discrimination(draw) for c in contests) for draw in draws])),
            )
            answers.append(answer)
            advice += _load_advice(arm, asked, poses, chosen, number, answer)
    return tuple(answers), tuple(dict.fromkeys(advice))


def _load_advice(
    arm: _Asking, asked: Question, poses: _Poses, chosen: Sequence[_Chosen], number: int, answer: Answer
) -> list[str]:
    """What another load at every second stop would do, where the stops alone do not tell and the run had but one."""
    slugs = [asked.effect, *([asked.against] if asked.against else [])]
    felt = any("payload" in EFFECTS[slug].variables for slug in slugs)
    if not felt or varies(arm.known.payload_kg) or (asked.against and answer.proposed >= answer.needed):
        return []
    present = _last(arm.known.payload_kg, 1)
    now_kg = arm.model.bodies.payload_mass if present is None else float(present[0])
    more_kg = max(round(2.0 * _LOAD_SHARE * float(arm.model.bodies.masses.sum())) / 2.0, 0.5)
    load_kg: Array = now_kg + more_kg * (np.arange(len(chosen)) % 2).astype(np.float64)
    pose = np.array([one.poses[number] for one in chosen], dtype=np.intp)
    way = np.array([one.ways[number] for one in chosen], dtype=np.intp)
    q, known = arm.of_candidates(poses, pose, way, load_kg)
    everything = np.arange(len(chosen))
    contests = asked.contests(There.of(asked.data, asked.fit, q, known))
    loaded = min(contest.discrimination(everything) for contest in contests)
    if loaded < _WORTH_A_LOAD * answer.proposed:
        return []
    what = f"{EFFECTS[asked.effect].title} and {EFFECTS[asked.against].title}" if asked.against else ""
    aim = f"tell {what} apart" if what else f"show {EFFECTS[asked.effect].title}"
    return [
        f"arm {arm.name}: another load would {aim} better: {now_kg + more_kg:g} kg instead of {now_kg:g} kg at every"
        f" second stop would bring the discrimination to {loaded:.0f} instead of {answer.proposed:.0f}; a person must"
        " hang it on, if the arm may carry it, and enter it in the controller"
    ]
