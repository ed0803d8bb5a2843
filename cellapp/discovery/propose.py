"""The verb's option ``--propose N``: the stops, and how to come to them, that would best tell what is ambiguous."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellapp.calibration.calibrate import CALIBRATION_FILE
from cellapp.calibration.circumstances import base_moment
from cellapp.discovery.data import ArmData, Fit
from cellapp.discovery.design import Contest, Race
from cellapp.discovery.discover import Discovery, known_of_all
from cellapp.discovery.questions import Question, There, fitted, questions
from cellapp.effects import EFFECTS, Circumstances, varies
from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel, CellModel
from cellapp.planning.cell_bodies import cell_bodies, home_positions
from cellapp.planning.factors import Factors, as_dict, read_factors, write_factors
from cellapp.planning.plan import draw_stops, rolled_stops
from cellapp.planning.safety import CellBodies, refuse_motion
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.run import Readings, RunFile

_POSES = 120
_ROLLS = 2
STEPS_RAD = (0.03, 0.5)
"""Small and large last steps of a joint."""
DWELLS_S = (0.5, 5.0)
"""Short and long rests before a measurement."""
_TWICE = 2
"""A posture, whatever its wrist roll, is proposed at most so often: designs like repetition, wrong laws do not."""
_REFUSALS = 400
"""Gate refusals in a row after which no further stop is looked for."""
_DRAWS = 8
_HOPELESS = 0.02
"""A question that all stops together would bring on by less than this share of what it needs is left aside."""
_WORST_FIRST = 3.0
_MEMORY = 3e8
"""For the candidates' columns [bytes]."""
_LOAD_KG = 3.0
"""What a person is told to hang on for example."""
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
    factors: Mapping[str, Factors]


@dataclass(frozen=True)
class Proposal:
    """The stops in the order of measuring, and what they are worth.

    ``first`` is the number of the first of them in the run's plan, None where they were not written into it.
    """

    stops: tuple[ProposedStop, ...]
    answers: tuple[Answer, ...]
    first: int | None
    notes: tuple[str, ...]
    advice: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON; ``stops`` has one flat row an arm and stop, as a table would."""
        rows = []
        for number, stop in enumerate(self.stops):
            for name, q in stop.q.items():
                asked = as_dict(stop.factors.get(name, Factors()))
                rows.append(
                    {
                        "configuration": (self.first or 0) + number,
                        "arm": name,
                        "q": q.tolist(),
                        "via": asked.get("via"),
                        "dwell_s": asked.get("dwell_s"),
                    }
                )
        arms: dict[str, list[dict[str, Any]]] = {}
        for answer in self.answers:
            arms.setdefault(answer.arm, []).append(
                {
                    "effect": answer.effect,
                    "against": answer.against or None,
                    "needed": answer.needed,
                    "discrimination": {
                        "now": answer.now,
                        "proposed": answer.proposed,
                        "random": answer.random,
                    },
                    "gain_over_random": answer.gain,
                }
            )
        return {
            "count": len(self.stops),
            "written": self.first is not None,
            "first_configuration": self.first,
            "arms": arms,
            "stops": rows,
            "notes": list(self.notes),
            "advice": list(self.advice),
        }


def propose_run(
    run: RunFile,
    found: Mapping[str, Discovery],
    count: int,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> Proposal:
    """Propose ``count`` further stops of all arms after ``found`` was discovered, and write them into the run.

    They take the place of earlier proposals that were not measured. A run that this program does not drive (no plan,
    or a driver ``none``) only gets the list.

    Raises
    ------
    InputError
        If the run is not calibrated, or no candidate stops can be made.
    Cancelled
        Nothing is written then.
    """
    cancel = cancel or CancelToken()
    profile = run.profile
    model = CellModel.load(run.folder / CALIBRATION_FILE)
    readings = {name: run.readings(name) for name in model.arms}
    rng = np.random.default_rng([profile.seed, 0x9409, max(len(arm) for arm in readings.values())])
    listener(Progress("propose", 0, count, "candidates"))
    poses, notes = _poses(profile, readings, rng, cancel)
    known = known_of_all(model, readings)
    asking = {
        name: _Asking.of(profile, name, model, readings, known[name], found[name], poses, count, rng)
        for name in model.arms
    }
    if not any(asked.questions for asked in asking.values()):
        raise InputError("propose: there is nothing that further stops could tell: no effect is ambiguous or hidden")
    poses = poses.first(min(asked.affordable for asked in asking.values()))
    for asked in asking.values():
        asked.prepare(poses)
    chosen = _select(asking, poses, count, listener, cancel)
    if not chosen:
        raise InputError("propose: the gate refused every candidate; make plan.clearance smaller, or move the bases")
    if len(chosen) < count:
        notes.append(f"only {len(chosen)} of {count} stops: the gate refused the other candidates")
    chosen = _ordered(chosen, asking, poses, rng)
    answers, advice = _answers(asking, poses, chosen, model, rng)
    stops = tuple(_stop(asking, poses, one) for one in chosen)
    first = None
    if why := _not_driven(run):
        notes.append(f"{why}: the stops are listed only; measure them, then import them with the earlier readings")
    else:
        first = _write(run, stops)
    listener(Progress("propose", count, count, "done"))
    return Proposal(stops, answers, first, tuple(notes), advice)


# -- candidates -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Poses:
    """Stops of all arms, name -> (n, N), and which are the same but for wrist rolls; ``gate`` None is no gate."""

    q: Mapping[str, Array]
    posture: NDArray[np.intp]
    gate: CellBodies | None
    homes: Mapping[str, Array]
    refused: dict[tuple[Any, ...], str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.posture)

    def first(self, count: int) -> _Poses:
        """The first so many."""
        if count >= len(self):
            return self
        return replace(self, q={name: q[:count] for name, q in self.q.items()}, posture=self.posture[:count])

    def at(self, pose: int) -> dict[str, Array]:
        return {name: q[pose] for name, q in self.q.items()}

    def home_is_free(self, here: Mapping[str, Array]) -> bool:
        """Whether the arms can go home one at a time, in some order."""
        assert self.gate is not None
        now, waiting = dict(here), list(self.homes)
        while waiting:
            free = [name for name in waiting if not refuse_motion(self.gate, now, {**now, name: self.homes[name]})]
            if not free:
                return False
            now[free[0]] = self.homes[free[0]]
            waiting.remove(free[0])
        return True


def _poses(
    profile: Profile, readings: Mapping[str, Readings], rng: np.random.Generator, cancel: CancelToken
) -> tuple[_Poses, list[str]]:
    """Candidates that are seen and safe; those that were measured where the profile does not say what that is."""
    described = profile.tracker.pose is not None and all(
        arm.base is not None and arm.home is not None and arm.type.capsules for arm in profile.arms.values()
    )
    if described:
        gate = cell_bodies(profile)
        drawn = draw_stops(gate, profile, _POSES, rng, cancel)
        q, posture = rolled_stops(gate, drawn, _ROLLS, rng)
        mixed = rng.permutation(len(posture))
        q = {name: rows[mixed] for name, rows in q.items()}
        return _Poses(q, posture[mixed], gate, home_positions(profile)), []
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
        asking.affordable = max(20, int(_MEMORY / max(2 * width * asking.ways * 24, 1)))
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
            contests = asked.contests(seen[id(asked.fit)])
            self.contests.append((asked, contests))
            self.races += [(asked, contest.begin()) for contest in contests]

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

    def factors(self, poses: _Poses, pose: int, way: int) -> Factors:
        """What the collection is asked for."""
        step = self.steps[pose, way]
        via = poses.q[self.name][pose] - step if step.any() else None
        return Factors(via, float(self.dwells[way]))


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

_Chosen = tuple[int, tuple[int, ...]]
"""A pose and the way of each arm."""


def _select(
    asking: Mapping[str, _Asking], poses: _Poses, count: int, listener: Listener, cancel: CancelToken
) -> list[_Chosen]:
    """Stop after stop the one that brings on the questions of all arms most, as far as the gate lets them."""
    chosen: list[_Chosen] = []
    arms = list(asking.values())
    used = np.zeros(int(poses.posture.max()) + 1, dtype=np.intp)
    open_to = np.ones(len(poses), dtype=bool)
    while len(chosen) < count:
        cancel.check()
        listener(Progress("propose", len(chosen), count, "stops"))
        worths = [arm.worth(count - len(chosen)) for arm in arms]
        one = None
        for _ in range(_REFUSALS):
            best = sum(worth.max(axis=1) for worth in worths)
            best = np.where(open_to & (used[poses.posture] < _TWICE), best, -math.inf)
            pose = int(np.argmax(best))
            if not math.isfinite(float(best[pose])):
                break
            ways = tuple(int(np.argmax(worth[pose])) for worth in worths)
            banned = _banned(arms, poses, pose, ways)
            if banned is None:
                one = (pose, ways)
                break
            if not banned:
                open_to[pose] = False
            for number in banned:
                arms[number].allowed[pose, ways[number]] = False
                worths[number][pose, ways[number]] = -math.inf
        if one is None:
            break
        pose, ways = one
        for arm, way in zip(arms, ways, strict=True):
            arm.take(pose, way)
        used[poses.posture[pose]] += 1
        chosen.append(one)
    return chosen


def _banned(arms: Sequence[_Asking], poses: _Poses, pose: int, ways: Sequence[int]) -> list[int] | None:
    """Which arms' ways to a pose the gate refuses; none of them if it is the pose itself; None if all is free."""
    if poses.gate is None:
        return None
    there = poses.at(pose)
    vias = _vias(arms, poses, pose, ways)
    start = {**there, **vias}
    if not poses.home_is_free(there):
        return []
    moving = [number for number, arm in enumerate(arms) if arm.name in vias]
    alone = [
        number
        for number in moving
        if refuse_motion(poses.gate, {**there, arms[number].name: vias[arms[number].name]}, there)
    ]
    if alone:
        return alone
    if refuse_motion(poses.gate, start, there) or refuse_motion(poses.gate, poses.homes, start):
        return moving
    return None


def _vias(arms: Sequence[_Asking], poses: _Poses, pose: int, ways: Sequence[int]) -> dict[str, Array]:
    found = {}
    for arm, way in zip(arms, ways, strict=True):
        via = arm.factors(poses, pose, way).via
        if via is not None:
            found[arm.name] = via
    return found


def _ordered(
    chosen: Sequence[_Chosen], asking: Mapping[str, _Asking], poses: _Poses, rng: np.random.Generator
) -> list[_Chosen]:
    """In random order, so that time is tied to nothing; with few ways by home where the straight one is refused."""
    left = [chosen[k] for k in rng.permutation(len(chosen))]
    if poses.gate is None:
        return left
    arms, here, ordered = list(asking.values()), dict(poses.homes), list[_Chosen]()
    while left:
        for one in left[:6]:
            start = {**poses.at(one[0]), **_vias(arms, poses, *one)}
            if not refuse_motion(poses.gate, here, start):
                break
        else:
            one = left[0]
        left.remove(one)
        ordered.append(one)
        here = poses.at(one[0])
    return ordered


def _stop(asking: Mapping[str, _Asking], poses: _Poses, one: _Chosen) -> ProposedStop:
    pose, ways = one
    factors = {arm.name: arm.factors(poses, pose, way) for arm, way in zip(asking.values(), ways, strict=True)}
    return ProposedStop(poses.at(pose), factors)


# -- what it is worth -------------------------------------------------------------------------------------------------


def _answers(
    asking: Mapping[str, _Asking],
    poses: _Poses,
    chosen: Sequence[_Chosen],
    model: CellModel,
    rng: np.random.Generator,
) -> tuple[tuple[Answer, ...], tuple[str, ...]]:
    """Discrimination of each question now, with the chosen stops, and with as many random ones (mean of some draws)."""
    answers, advice = [], []
    for number, arm in enumerate(asking.values()):
        picked = np.array([pose * arm.ways + ways[number] for pose, ways in chosen], dtype=np.intp)
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
    """What another load at every second stop would do, where the effects feel one and the run had but one."""
    slugs = [asked.effect, *([asked.against] if asked.against else [])]
    if not any("payload" in EFFECTS[slug].variables for slug in slugs) or varies(arm.known.payload_kg):
        return []
    present = _last(arm.known.payload_kg, 1)
    now_kg = arm.model.bodies.payload_mass if present is None else float(present[0])
    load_kg: Array = now_kg + _LOAD_KG * (np.arange(len(chosen)) % 2).astype(np.float64)
    pose = np.array([pose for pose, _ in chosen], dtype=np.intp)
    way = np.array([ways[number] for _, ways in chosen], dtype=np.intp)
    q, known = arm.of_candidates(poses, pose, way, load_kg)
    everything = np.arange(len(chosen))
    contests = asked.contests(There.of(asked.data, asked.fit, q, known))
    loaded = min(contest.discrimination(everything) for contest in contests)
    if loaded < _WORTH_A_LOAD * answer.proposed:
        return []
    what = f"{EFFECTS[asked.effect].title} and {EFFECTS[asked.against].title}" if asked.against else ""
    aim = f"tell {what} apart" if what else f"show {EFFECTS[asked.effect].title}"
    return [
        f"arm {arm.name}: another load would {aim} better: {now_kg + _LOAD_KG:g} kg instead of {now_kg:g} kg at every"
        f" second stop would bring the discrimination to {loaded:.0f} instead of {answer.proposed:.0f}; a person must"
        " hang it on and enter it in the controller"
    ]


# -- into the run -----------------------------------------------------------------------------------------------------


def _not_driven(run: RunFile) -> str:
    """Why this program cannot drive further stops of a run; empty if it can."""
    drivers: dict[str, str] = {f"arms.{name}": arm.driver.kind for name, arm in run.profile.arms.items()}
    drivers["tracker"] = run.profile.tracker.driver.kind
    none = [what for what, kind in drivers.items() if kind == "none"]
    if none:
        return f"the driver of {none[0]} is 'none'"
    return "" if run.read_plan() else "the run has no plan (it was imported)"


def _write(run: RunFile, stops: Sequence[ProposedStop]) -> int:
    """Put the stops behind the plan, in place of earlier proposals that were not measured. Returns the first number."""
    plan, done, factors = run.read_plan(), run.stops_done(), read_factors(run)
    first = len(next(iter(plan.values())))
    while first - 1 in factors and first - 1 not in done:
        first -= 1
    run.write_plan(
        {name: np.concatenate([rows[:first], [stop.q[name] for stop in stops]]) for name, rows in plan.items()}
    )
    kept = {stop: arms for stop, arms in factors.items() if stop < first}
    write_factors(run, {**kept, **{first + k: stop.factors for k, stop in enumerate(stops)}})
    return first
