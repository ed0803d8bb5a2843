"""A complete plan: stops of all arms in their order, how each is reached, what it is for; in memory and in a run.

Estimated time of collecting a plan: motions, rests, measurements, references, warm-up.
"""

from __future__ import annotations

import math
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from cellapp.cell.planning.records import PlanDesignResult, PlannedTime
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.safety.gate import CellBodies, refuse_motion
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Arm, Profile
from cellapp.ground.progress import JobToken, Notice, duration_words
from cellapp.ground.results import Record
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import joint_rates

Configuration = Mapping[str, Array]
"""Arm -> joint positions (N,) [rad]; on a leg, only the arms that move."""
Route = tuple[Configuration, ...]
"""Consecutive motions, each with the targets of the arms that move."""


@dataclass(frozen=True, eq=False)
class PlannedStops:
    """n stops of all arms in the order of measurement.

    Attributes
    ----------
    q : mapping
        Arm -> joint positions (n, N) [rad].
    approach_from : mapping
        Arm -> joint positions before the last motion to each stop (n, N) [rad]; rows of NaN: no planned approach.
    dwell_s : mapping
        Arm -> least rest before the measurement (n,) [s].
    legs : tuple
        For each stop, the motions from the stop before (home before the first) to where the last motion begins, without
        the one that ends there: empty where the straight motion is free.
    block : array, shape (n,), int
        Part of the run to which the stop belongs.
    repeat_of : array, shape (n,), int
        Index of the stop whose configuration is visited again; -1 for none.
    frozen : array, shape (n,), bool
        Stops that a person chose; a new design leaves them as they are.
    load : array, shape (n,), int
        What the arms carry: 0 for ``payload`` of the profile, from 1 on ``payloads``.
    proposed : array, shape (n,), bool
        Stops that discovery proposed.
    """

    q: Mapping[str, Array]
    approach_from: Mapping[str, Array]
    dwell_s: Mapping[str, Array]
    legs: tuple[tuple[Configuration, ...], ...]
    block: NDArray[np.intp]
    repeat_of: NDArray[np.intp]
    frozen: NDArray[np.bool_]
    load: NDArray[np.intp]
    proposed: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.block)

    def targets(self, stop: int) -> dict[str, Array]:
        """Return the joint positions (N,) of all arms at a stop."""
        return {name: q[stop] for name, q in self.q.items()}

    def approach_starts(self, stop: int) -> dict[str, Array]:
        """Return the joint positions (N,) before the last motion, for the arms whose approach is planned."""
        return {name: q[stop] for name, q in self.approach_from.items() if np.isfinite(q[stop]).all()}

    def take(self, rows: Sequence[int] | NDArray[np.intp]) -> PlannedStops:
        """Select some of the stops, in the given order.

        Legs to a stop with a new predecessor are dropped, as they begin elsewhere. A repeat of a stop that is not
        selected becomes an ordinary stop.
        """
        chosen = np.asarray(rows, dtype=np.intp)
        place = np.full(len(self) + 1, -1, dtype=np.intp)  # the last one stands for "no repeat"
        place[chosen] = np.arange(len(chosen))
        every = self._each(lambda values: values[chosen])
        legs = [
            self.legs[row] if row == before + 1 else () for before, row in zip([-1, *chosen.tolist()], chosen.tolist())
        ]
        return replace(every, legs=tuple(legs), repeat_of=place[self.repeat_of[chosen]])

    def _each(self, change: Callable[..., Array], *others: PlannedStops) -> PlannedStops:
        """Change the arrays of all stops, given with those of ``others``."""
        found: dict[str, Any] = {}
        for entry in fields(self):
            own, *theirs = (getattr(one, entry.name) for one in (self, *others))
            if isinstance(own, np.ndarray):
                found[entry.name] = change(own, *theirs)
            elif entry.name != "legs":
                found[entry.name] = {name: change(rows, *(one[name] for one in theirs)) for name, rows in own.items()}
        return replace(self, **found)


def straight_stops(q: Mapping[str, Array]) -> PlannedStops:
    """Make stops (arm -> q (n, N) [rad]) with straight motions, without planned approach or dwell, in one block."""
    n = len(next(iter(q.values()), ()))
    return PlannedStops(
        q=q,
        approach_from={name: np.full_like(rows, np.nan) for name, rows in q.items()},
        dwell_s={name: np.zeros(n) for name in q},
        legs=((),) * n,
        block=np.zeros(n, dtype=np.intp),
        repeat_of=np.full(n, -1, dtype=np.intp),
        frozen=np.zeros(n, dtype=np.bool_),
        load=np.zeros(n, dtype=np.intp),
        proposed=np.zeros(n, dtype=np.bool_),
    )


def joined(first: PlannedStops, second: PlannedStops) -> PlannedStops:
    """Append the stops of ``second``, without legs to its first one; both plans have the same arms."""
    later = np.where(second.repeat_of < 0, -1, second.repeat_of + len(first))
    both = first._each(lambda *parts: np.concatenate(parts), replace(second, repeat_of=later))
    return replace(both, legs=(*first.legs, *(((), *second.legs[1:]) if min(len(first), len(second)) else second.legs)))


def begin_of(q: Array, step: Array) -> Array:
    """Compute where the last motions ``step`` (n, N) to stops ``q`` begin (n, N) [rad]; NaN where no joint moves."""
    return np.where(np.any(step != 0.0, axis=1, keepdims=True), q - step, np.nan)


def last_motions(stops: PlannedStops, homes: Configuration) -> dict[str, Array]:
    """Compute the signed last motion of each joint before each stop, arm -> (n, N) [rad].

    It is the planned one, else straight from the stop before, or from ``homes`` before the first.
    """
    motions = {}
    for name, q in stops.q.items():
        before = np.concatenate([homes[name][None], q])[: len(q)]
        begin = stops.approach_from[name]
        motions[name] = q - np.where(np.isfinite(begin), begin, before)
    return motions


def without_reserves(profile: Profile, stops: PlannedStops) -> PlannedStops:
    """Leave out the reserve stops of a plan."""
    reserves = profile.plan.reserves(len(stops))
    return stops.take([stop for stop in range(len(stops)) if stop not in reserves])


def joined_after(first: PlannedStops, second: PlannedStops) -> PlannedStops:
    """Append stops that were planned to follow ``first``: with all their legs, in blocks of their own."""
    both = joined(first, replace(second, block=second.block + int(first.block.max(initial=-1)) + 1))
    return replace(both, legs=(*first.legs, *second.legs))


def routes(stops: PlannedStops, stop: int, *, as_planned: bool) -> Iterator[Route]:
    """Yield routes to a stop in the order of preference; each ends with the planned last motion, which keeps its side.

    The routes: the planned legs if the arms are where these begin (``as_planned``); straight to where the last motion
    begins; to there one arm after the other; the planned legs from wherever the arms are.
    """
    starts, targets = stops.approach_starts(stop), stops.targets(stop)
    begin = {**targets, **starts}
    last: Route = ({name: targets[name] for name in starts},) if starts else ()
    planned: Route = (*stops.legs[stop], begin, *last)
    if as_planned and stops.legs[stop]:
        yield planned
    yield (begin, *last)
    for one_by_one in orders(begin) if len(begin) > 1 else ():
        yield (*one_by_one, *last)
    if stops.legs[stop] and not as_planned:
        yield planned


def orders(targets: Configuration) -> Iterator[Route]:
    """Yield the orders in which the arms can move to their targets one after the other."""
    for order in permutations(targets):
        yield tuple({name: targets[name]} for name in order)


def refused_route(cell: CellBodies, here: Configuration, route: Route) -> str:
    """Return why the arms cannot take a route, naming the motion if there are several; empty if they can."""
    for number, motion in enumerate(route, start=1):
        there = {**here, **motion}
        if reason := refuse_motion(cell, here, there):
            return reason if len(route) == 1 else f"motion {number} of {len(route)}: {reason}"
        here = there
    return ""


def can_go(cell: CellBodies, here: Configuration, there: Configuration) -> bool:
    """Return whether the arms can move all at once, or one after the other in some order, as the collection does."""
    return any(not refused_route(cell, here, route) for route in ((there,), *orders(there)))


def reason_of(error: Exception) -> str:
    """Say briefly what is wrong with a document."""
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False)[0]
        return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    return str(error)


# -- Storage of a plan in its run, as ``PlannedStops``, and of its design ---------------------------------------------
#
# The table ``plan`` holds the joint positions, the document ``factors`` approach and dwell: ``{stop: {arm: {"via": [q1,
# ...], "dwell_s": s, "proposed": false}}}``. Stops count from 0; all keys are optional. A stop that is listed was
# proposed by discovery unless it says otherwise. The document ``planned_stops`` holds the rest: ``{"legs": {stop:
# [{arm: [q1, ...]}, ...]}, "block": [...], "repeat_of": {stop: stop}, "frozen": [stop, ...], "load": [...]}``,
# ``block`` and ``load`` for each stop; without loads, the profile's payload. In runs without this document all motions
# are straight and all stops in one block. All three are written in one transaction.


STOP_CONDITIONS_RESULT = "factors"
PLANNED_STOPS_RESULT = "planned_stops"
PLAN_DESIGN_RESULT = "plan_design"
"""Names of the documents; they are part of the file format."""
LONGEST_DWELL_S = 600.0
"""Longest dwell time that is accepted: ten minutes, some time constants of an arm that settles."""


class _StoredConditions(Record):
    """Approach and dwell of one arm at one stop as they are stored."""

    via: tuple[float, ...] | None = None
    dwell_s: float = 0.0
    proposed: bool = True


_DOCUMENT = TypeAdapter(dict[int, dict[str, _StoredConditions]])


class _StoredPlan(Record):
    """The document ``planned_stops``."""

    legs: Mapping[int, tuple[Mapping[str, tuple[float, ...]], ...]] = {}
    block: tuple[int, ...]
    repeat_of: Mapping[int, int] = {}
    frozen: tuple[int, ...] = ()
    load: tuple[int, ...] = ()


def read_planned_stops(run: RunFile) -> PlannedStops:
    """Read the plan of a run; it has no stops if the run has no plan.

    Raises
    ------
    InputError
        If one of its documents is damaged.
    """
    stops = straight_stops(run.read_plan())
    try:
        _add_conditions(run, stops)
    except (ValueError, KeyError) as error:
        raise InputError(
            f"{run.path}: the document '{STOP_CONDITIONS_RESULT}' with approach and dwell of its stops is damaged"
            f" ({reason_of(error)}); restore the run from a copy, or plan a new one"
        ) from None
    text = run.read_document(PLANNED_STOPS_RESULT)
    if text is None:
        return stops
    try:
        return _with_stored(stops, _StoredPlan.model_validate_json(text), run.profile.loads)
    except (ValidationError, ValueError) as error:
        raise InputError(
            f"{run.path}: the document '{PLANNED_STOPS_RESULT}' with the ways of its plan is damaged"
            f" ({reason_of(error)}); restore the run from a copy, or plan a new one"
        ) from None


def write_planned_stops(run: RunFile, stops: PlannedStops, *, design: PlanDesignResult | None = None) -> None:
    """Store a plan in place of the one before; ``design`` describes its design, None keeps the stored one.

    Raises
    ------
    InputError
        If a stop that is already measured would change.
    """
    documents = {
        STOP_CONDITIONS_RESULT: _DOCUMENT.dump_json(_conditions_of(stops), exclude_defaults=True).decode(),
        PLANNED_STOPS_RESULT: _StoredPlan(
            legs={
                stop: tuple({name: tuple(q.tolist()) for name, q in leg.items()} for leg in legs)
                for stop, legs in enumerate(stops.legs)
                if legs
            },
            block=tuple(stops.block.tolist()),
            repeat_of={stop: source for stop, source in enumerate(stops.repeat_of.tolist()) if source >= 0},
            frozen=tuple(np.flatnonzero(stops.frozen).tolist()),
            load=tuple(stops.load.tolist()) if stops.load.any() else (),
        ).model_dump_json(exclude_defaults=True),
    }
    if design is not None:
        documents[PLAN_DESIGN_RESULT] = design.to_json()
    run.write_plan(stops.q, documents)


def read_plan_design(run: RunFile) -> PlanDesignResult | None:
    """Read the design of a run's plan; None if it was not designed. Raise ``InputError`` if it is damaged."""
    text = run.read_document(PLAN_DESIGN_RESULT)
    return None if text is None else PlanDesignResult.from_json(text, f"{run.path}: {PLAN_DESIGN_RESULT}")


def _conditions_of(stops: PlannedStops) -> dict[int, dict[str, _StoredConditions]]:
    """Collect approach and dwell of each arm at each stop that has some, or that discovery proposed."""
    found: dict[int, dict[str, _StoredConditions]] = {}
    for stop, proposed in enumerate(stops.proposed.tolist()):
        via = {name: tuple(q.tolist()) for name, q in stops.approach_starts(stop).items()}
        dwell_s = {name: float(rest[stop]) for name, rest in stops.dwell_s.items()}
        if proposed or via or any(rest > 0.0 for rest in dwell_s.values()):
            found[stop] = {
                name: _StoredConditions(via=via.get(name), dwell_s=rest, proposed=proposed)
                for name, rest in dwell_s.items()
            }
    return found


def _add_conditions(run: RunFile, stops: PlannedStops) -> None:
    """Enter stored approaches and dwells. Raise ``ValueError`` or ``KeyError`` if the document does not fit the run."""
    for stop, arms in _DOCUMENT.validate_json(run.read_document(STOP_CONDITIONS_RESULT) or "{}").items():
        for arm, stored in arms.items():
            joints = len(run.profile.arms[arm].type.joints)
            if stored.via is not None and not (len(stored.via) == joints and all(map(math.isfinite, stored.via))):
                raise ValueError(f"arm {arm}: 'via' must be {joints} finite joint positions")
            if not (math.isfinite(stored.dwell_s) and 0.0 <= stored.dwell_s <= LONGEST_DWELL_S):
                raise ValueError(f"arm {arm}: 'dwell_s' must lie between 0 and {LONGEST_DWELL_S:g} s")
            if 0 <= stop < len(stops) and arm in stops.q:
                stops.proposed[stop] |= stored.proposed
                stops.dwell_s[arm][stop] = stored.dwell_s
                if stored.via is not None:
                    stops.approach_from[arm][stop] = stored.via


def _with_stored(stops: PlannedStops, stored: _StoredPlan, loads: int) -> PlannedStops:
    """Complete the stops by the document. Raise ``ValueError`` if it does not fit them.

    Stops that were appended without it are in the last block and have the last load.
    """
    n = len(stops)
    numbers = [*stored.legs, *stored.repeat_of, *stored.repeat_of.values(), *stored.frozen]
    if max(len(stored.block), len(stored.load)) > n or any(not 0 <= stop < n for stop in numbers):
        raise ValueError(f"it tells of more stops than the {n} that are planned")
    legs = [stored.legs.get(stop, ()) for stop in range(n)]
    if not all(0 <= load < loads for load in stored.load):
        raise ValueError(f"it tells of load {max(stored.load)}, the profile has 0 to {loads - 1}")
    frozen = np.zeros(n, dtype=np.bool_)
    frozen[list(stored.frozen)] = True
    return replace(
        stops,
        legs=tuple(tuple(_checked_leg(stops.q, leg, stop) for leg in of_stop) for stop, of_stop in enumerate(legs)),
        block=_continued(stored.block, n),
        repeat_of=np.array([stored.repeat_of.get(stop, -1) for stop in range(n)], dtype=np.intp),
        frozen=frozen,
        load=_continued(stored.load, n),
    )


def _continued(values: tuple[int, ...], n: int) -> NDArray[np.intp]:
    """Return the values (n,), the last one repeated for the remaining stops; zeros if there is none."""
    last = values[-1] if values else 0
    return np.array((*values, *(last,) * (n - len(values))), dtype=np.intp)


def _checked_leg(plan: Mapping[str, Array], leg: Mapping[str, tuple[float, ...]], stop: int) -> Configuration:
    for name, q in leg.items():
        if name not in plan:
            raise ValueError(f"stop {stop}: a leg moves the arm '{name}', which has no plan")
        joints = plan[name].shape[1]
        if len(q) != joints or not all(map(math.isfinite, q)):
            raise ValueError(f"stop {stop}: a leg of arm {name} must have {joints} finite joint positions")
    return {name: np.array(q, dtype=np.float64) for name, q in leg.items()}


_SETTLE_S = 0.2
"""Rest after a motion before an arm counts as settled: the default of UR controllers and of simulated arms."""
_POINTING_S = 1.0
"""Time for the tracker to turn to the next SMR and to lock it; its head turns a quarter in half a second."""


@dataclass(frozen=True, eq=False)
class StopTimes:
    """Expected times of n stops.

    Attributes
    ----------
    moving_s, resting_s : arrays, shape (n,)
        Of the motion to each stop, and of the rest before its measurement [s].
    measuring_s : float
        Of all arms at one stop [s].
    travel_s : float
        Of all motions, with that home from the last stop [s].
    """

    moving_s: Array
    resting_s: Array
    measuring_s: float
    travel_s: float

    @property
    def measured_s(self) -> Array:
        """When each stop is measured, in seconds since the first motion, shape (n,)."""
        return np.cumsum(self.moving_s + self.resting_s + self.measuring_s) - 0.5 * self.measuring_s


def motion_s(arm: Arm, way: Array) -> Array:
    """Compute the time of joint motions ``way`` (n, N) [rad] from rest to rest, shape (n,) [s].

    All joints start and end together, with a trapezoidal speed profile inside the arm's speeds and accelerations.
    """
    speed, acceleration = joint_rates(arm)
    at_speed = np.abs(way / speed).max(axis=1)
    at_acceleration = np.abs(way / acceleration).max(axis=1)
    # with ramps of a / v each: distance 1 = v * (T - a / v), or a triangle where full speed is never reached
    triangle = at_speed**2 < at_acceleration
    ramp = np.divide(at_acceleration, at_speed, out=np.zeros_like(at_speed), where=at_speed > 0.0)
    return np.asarray(np.where(triangle, 2.0 * np.sqrt(at_acceleration), at_speed + ramp))


def stop_times_of(profile: Profile, stops: PlannedStops) -> StopTimes:
    """Estimate the times of planned stops with their approaches and detours, from home."""
    here = home_positions(profile)
    begin = {
        name: np.where(np.isfinite(stops.approach_from[name]), stops.approach_from[name], q)
        for name, q in stops.q.items()
    }
    moving_s = np.max(
        [_straight_s(profile.arms[name], here.get(name), q, begin[name]) for name, q in stops.q.items()], axis=0
    )
    motions = np.ones(len(stops))
    last_s = np.max([motion_s(profile.arms[name], q - begin[name]) for name, q in stops.q.items()], axis=0)
    for stop, legs in enumerate(stops.legs):
        if legs:
            before = stops.targets(stop - 1) if stop else here
            moving_s[stop] = route_s(profile, before, (*legs, {name: q[stop] for name, q in begin.items()}))
            motions[stop] += len(legs)
    slow = profile.collection.slow_start
    moving_s += last_s
    if profile.moves_hardware:
        moving_s[: slow.stops] /= slow.speed
    dwell_s = np.max([stops.dwell_s[name] for name in stops.q], axis=0)
    resting_s = np.maximum(_SETTLE_S, dwell_s) + _SETTLE_S * (motions - 1.0 + (last_s > 0.0))
    ways = [motion_s(profile.arms[name], (here[name] - q[-1])[None]) for name, q in stops.q.items() if name in here]
    home_s = float(np.max(ways)) if ways else 0.0
    return StopTimes(moving_s, resting_s, _measuring_s(profile) * len(stops.q), float(moving_s.sum()) + home_s)


def route_s(profile: Profile, start: Configuration, route: Route) -> float:
    """Compute the time of consecutive motions from ``start`` (all arms) [s]; each takes as long as its slowest arm."""
    here, total = dict(start), 0.0
    for targets in route:
        total += max(float(motion_s(profile.arms[name], (q - here[name])[None])[0]) for name, q in targets.items())
        here.update(targets)
    return total


def _straight_s(arm: Arm, start: Array | None, q: Array, begin: Array) -> Array:
    """Compute the time from each stop to where the next last motion begins, (n,) [s]; 0 from unknown ``start``."""
    first = begin[:1] if start is None else start[None]
    return motion_s(arm, begin - np.concatenate([first, q])[: len(q)])


def planned_time(profile: Profile, stops: PlannedStops) -> PlannedTime:
    """Estimate the time of collecting planned stops and going home."""
    times = stop_times_of(profile, stops)
    reference = profile.collection.reference
    references_s = 0.0
    if reference.every > 0:
        count = 2 + (len(times.moving_s) - 1) // reference.every
        points = len(stops.q) + len(reference.nests)
        references_s = count * (2.0 * float(np.mean(times.moving_s)) + points * _measuring_s(profile))
    parts = {
        "moving_s": times.travel_s,
        "resting_s": float(times.resting_s.sum()),
        "measuring_s": times.measuring_s * len(times.moving_s),
        "references_s": references_s,
        "warm_up_s": profile.collection.warm_up,
    }
    return PlannedTime(total_s=sum(parts.values()), **parts)


def visits_s(profile: Profile, visits: Sequence[Configuration], dwell_s: float = _SETTLE_S) -> float:
    """Estimate the time of visiting configurations from home, with a rest and a measurement of each arm at each [s]."""
    if not visits:
        return 0.0
    start = {**ChainMap(*map(dict, visits)), **home_positions(profile)}
    measured = sum(len(visit) for visit in visits)
    return route_s(profile, start, tuple(visits)) + measured * (dwell_s + _measuring_s(profile))


def tell_time(
    job: JobToken, name: str, profile: Profile, seconds: float, done: int, total: int, how: str = "takes about"
) -> None:
    """Say before a job's first motion how long the job takes, by the plan of its motions."""
    kind = profile.cell_kind
    clock = "" if kind == "real" else f" by the clock of {kind} arms, which may run faster than yours"
    job.tell(name, done, total, detail=Notice(f"{how} {duration_words(seconds)}{clock}"))


def _measuring_s(profile: Profile) -> float:
    """Return the time of pointing at one SMR and measuring it, twice if repeats are required."""
    return _POINTING_S + (2 if profile.collection.repeat.precision is not None else 1) * profile.tracker.averaging
