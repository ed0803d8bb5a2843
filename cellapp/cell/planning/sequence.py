"""From the chosen stops of each arm to a plan: pairs, order, factors and paths; the gate accepts every motion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.arrangement import Arrangement, StopSet, arrange, block_count
from cellapp.cell.planning.balance import FactorPlan
from cellapp.cell.planning.candidates import joint_ranges
from cellapp.cell.planning.planned_stops import (
    Configuration,
    PlannedStops,
    Route,
    begin_of,
    can_go,
    joined_after,
    straight_stops,
)
from cellapp.cell.planning.transit_paths import Move, TransitPlanner
from cellapp.cell.safety.gate import CellBodies, FreeMotions, clear_stops, refuse_motion
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobSteps, JobToken
from cellapp.robot.kinematics.inverse import shifted_into
from cellapp.robot.kinematics.transforms import Array

_JOB = "order"
_LARGEST_REPEATED_SHARE = 4
"""At most every fourth stop is a repeat."""


def sequenced(
    finder: TransitPlanner,
    chosen: Mapping[str, Array],
    rng: np.random.Generator,
    job: JobToken = UNATTENDED,
    after: Configuration | None = None,
    repeats: int | None = None,
) -> tuple[PlannedStops, list[str]]:
    """Pair the chosen stops of all arms, order them, plan their factors and paths.

    ``plan.stops`` and ``plan.reserve`` stops are planned, reserves last, or fewer if fewer are chosen. Further ones
    replace those that no motion reaches; some stops are visited twice in place of others.

    Parameters
    ----------
    finder : TransitPlanner
        Of the cell.
    chosen : mapping
        Arm -> joint positions (n, N) [rad], the most important first. Joints may be planned at whole turns from these.
    rng : numpy.random.Generator
    job
        Progress and cancelling.
    after : mapping, optional
        The last of the stops that exist already, at which the new ones begin. As many stops are planned as are chosen,
        without reserves.
    repeats : int, optional
        Stops that are visited twice, if there are enough; by default ``plan.repeats``.

    Returns
    -------
    PlannedStops
        None if no stop can be reached after those that exist.
    list of str
        One sentence on each chosen configuration or stop that was given up, with the reason.

    Raises
    ------
    InputError
        If no stop of a new plan can be reached.
    Cancelled
    """
    plan, given_up = finder.profile.plan, list[str]()
    q = {name: _reached(finder, name, rows, given_up) for name, rows in chosen.items()}
    usable, n = min(map(len, q.values())), min(map(len, chosen.values()))
    if not usable:
        raise InputError(f"plan: none of the chosen stops can be reached. {' '.join(given_up[:1])}".strip())
    reserve = min(plan.reserve, n - 1) if after is None else 0
    asked = min(n - reserve, plan.stops) if after is None else n
    repeats = min(plan.repeats if repeats is None else repeats, asked // _LARGEST_REPEATED_SHARE)
    distinct = min(asked - repeats, usable)
    repeats = min(repeats, distinct // (_LARGEST_REPEATED_SHARE - 1))
    first = {name: rows[:distinct] for name, rows in q.items()}
    planned = _part(finder, first, repeats, after or finder.home, rng, job, given_up)
    if not len(planned) and after is None:
        raise InputError(f"plan: none of the chosen stops can be reached: {given_up[-1]}")
    if min(reserve, usable - distinct):
        rest = {name: rows[distinct : min(distinct + reserve, usable)] for name, rows in q.items()}
        second = _part(finder, rest, 0, planned.targets(len(planned) - 1), rng, job, given_up)
        planned = joined_after(planned, second) if len(second) else planned
    job.tell(_JOB, len(planned), len(planned), "done")
    return planned, given_up


def _reached(finder: TransitPlanner, name: str, q: Array, given_up: list[str]) -> Array:
    """Select the configurations (m, N) that the arm alone can reach, in the turns in which they are planned."""
    cell, roadmap = finder.cell, finder.roadmaps[name]
    shifted = nearest_turns(finder.profile, cell, name, q)
    reached = roadmap.reaches(shifted)
    if not reached.all():
        alone, lost = replace(cell, arms={name: cell.arms[name]}), shifted[np.argmin(reached)]
        reason = refuse_motion(alone, {name: roadmap.rest}, {name: lost})
        given_up.append(
            f"arm {name}: {np.sum(~reached)} of {len(q)} chosen configurations cannot be reached from home, the first:"
            f" {reason or 'within the allowance for sampled paths'}"
        )
    return shifted[reached]


def nearest_turns(profile: Profile, cell: CellBodies, name: str, q: Array) -> Array:
    """Turn each joint by whole turns to be nearest to home, within the limits or ``plan.ranges``; poses stay the same.

    Many poses whose straight motion from home is blocked by the arm itself or by the floor are free in another turn.
    """
    home = profile.arms[name].home
    low, high = joint_ranges(cell, profile, name).T if profile.plan.ranges is not None else cell.arms[name].limits.T
    centre = 0.5 * (low + high) if home is None else np.array(home)
    near, beyond = shifted_into(q, np.stack([low, high], axis=1), centre)
    return np.where(beyond > 0.0, q, near)


def _part(
    finder: TransitPlanner,
    q: Mapping[str, Array],
    repeats: int,
    start: Configuration | None,
    rng: np.random.Generator,
    job: JobToken,
    given_up: list[str],
) -> PlannedStops:
    """Plan stops that follow ``start``, none if none can be reached; from the last one the arms can go home."""
    profile, cell, home = finder.profile, finder.cell, finder.home
    least = min(map(len, q.values()))
    n = least + repeats
    steps = JobSteps(lambda done, words: job.tell(_JOB, done, n, words), job)
    steps(0, "pairs and order")
    stops = StopSet(profile, cell, {name: rows[:least] for name, rows in q.items()})
    arrangement = arrange(stops, block_count(profile.plan.blocks, n), repeats, rng, job)
    arrangement = repair_order(stops, arrangement, start, home, finder.gate, job)
    at = stops.at(arrangement.rows)
    factors = FactorPlan(profile, cell, at, arrangement.block, arrangement.repeat_of, rng)
    legs = LegPlanner(at, arrangement, factors, finder, start)
    planned = legs.plan(steps)
    given_up += legs.given_up
    while len(planned) and home is not None and not can_go(cell, planned.targets(len(planned) - 1), home):
        planned = planned.take(range(len(planned) - 1))
        given_up.append("the last stop has no way home")
    return planned


# -- Last motions and paths of an arrangement of stops: where the gate refuses, other sides and steps, or a detour ----


_MOST_WAYS = 6
"""Number of sides and steps of one stop for which the gate is asked about the motion to it. If it refuses all, the stop
itself is hard to reach, and a detour is sought."""
_REPORT_EVERY = 10
"""Stops between two reports of progress."""
_AHEAD = 100
"""Number of stops that are looked ahead: for those whose motions the gate refuses, other steps are sampled and asked
about in one batch. Few, as steps that are sampled together do not balance each other."""

Steps = Mapping[str, Array]
"""Arm -> signed steps of the last motion to one stop (N,) [rad]."""


class LegPlanner:
    """Plan of how each stop is reached from the one before it; ``start`` (None: anywhere) is before the first."""

    def __init__(
        self,
        q: Mapping[str, Array],
        arrangement: Arrangement,
        factors: FactorPlan,
        finder: TransitPlanner,
        start: Configuration | None,
    ) -> None:
        self._q, self._arrangement = q, arrangement
        self._factors, self._finder, self._start = factors, finder, start
        self._step = factors.approaches()
        self._before: dict[int, Configuration | None] = {}
        """Where the arms are before each stop that is reached."""
        self._others: dict[int, list[Steps]] = {}
        """Other steps of the next stops."""
        self.given_up: list[str] = []
        """One sentence for each stop that cannot be reached."""

    def plan(self, steps: JobSteps) -> PlannedStops:
        """Plan the stops that can be reached, in their order."""
        n = len(self._arrangement.block)
        self._ask((stop, self._planned_before(stop), self._own(stop)) for stop in range(n))
        legs: dict[int, Route] = {}
        here = self._start
        for stop in range(n):
            steps.check()
            if stop % _REPORT_EVERY == 0:
                steps(stop, "ways")
            if stop % _AHEAD == 0:
                self._look_ahead(range(stop, min(stop + _AHEAD, n)))
            way = self._reach(stop, here)
            if isinstance(way, str):
                self.given_up.append(f"a stop in block {self._arrangement.block[stop] + 1} has no way to it: {way}")
                continue
            legs[stop], self._before[stop] = way, here
            here = self._at(stop)
        changeable = np.array([not legs.get(stop, ({},)) for stop in range(n)], dtype=np.bool_)
        self._factors.improve(self._step, changeable, self._accepts)
        whole = replace(
            straight_stops(self._q),
            approach_from={name: begin_of(q, self._step[name]) for name, q in self._q.items()},
            dwell_s=self._factors.dwell_s(self._step),
            block=self._arrangement.block,
            repeat_of=self._arrangement.repeat_of,
        )
        return replace(whole.take(list(legs)), legs=tuple(legs.values()))

    def _look_ahead(self, stops: range) -> None:
        """Sample other steps of stops whose planned motions the gate refuses, and ask about the first of each."""
        once = [stop for stop in stops if self._arrangement.repeat_of[stop] < 0]
        refused = [stop for stop in once if not self._is_free(stop, self._planned_before(stop), self._own(stop))]
        self._others = self._other_steps(refused)
        some = [(stop, others[0]) for stop, others in self._others.items() if others]
        self._ask((stop, self._planned_before(stop), steps) for stop, steps in some)

    def _own(self, stop: int) -> dict[str, Array]:
        """Return the planned steps of a stop."""
        return {name: step[stop] for name, step in self._step.items()}

    def _planned_before(self, stop: int) -> Configuration | None:
        """Return where the arms are before a stop, if the one before it is not given up."""
        return self._start if stop == 0 else self._at(stop - 1)

    def _reach(self, stop: int, here: Configuration | None) -> Route | str:
        """Find legs to a stop, changing its steps where the gate refuses them; the reason if there is no path."""
        own = self._own(stop)
        usable, asked = None, 0
        for steps in self._steps_to(stop, here, own):
            if not self._last_is_free(stop, steps):
                continue
            usable, asked = usable or steps, asked + 1
            if self._way_is_free(stop, here, steps):
                self._set(stop, steps)
                return ()
            if asked == _MOST_WAYS:
                break
        if usable is None:  # none: the last motion comes straight from the stop before
            usable = {name: np.zeros_like(step) for name, step in own.items()}
        self._set(stop, usable)
        if here is None:
            return ()
        return self._finder.find(here, self._begin_of(stop, usable))

    def _steps_to(self, stop: int, here: Configuration | None, own: Steps) -> Iterator[Steps]:
        """Yield the planned steps of a stop, then others whose last motion begins where the arms are clear.

        A repeat has the steps of its stop, mirrored, and no others. The gate mostly accepts the first of the others: it
        is asked about one, then about growing batches.
        """
        yield own
        if self._arrangement.repeat_of[stop] >= 0:
            return
        others = self._others.pop(stop, None)
        if others is None:  # the stop before was given up
            others = self._other_steps([stop])[stop]
        asked = 0
        for number, steps in enumerate(others):
            if number == asked:
                asked = 3 * number + 1
                self._ask((stop, here, one) for one in others[number:asked])
            yield steps

    def _other_steps(self, stops: Sequence[int]) -> dict[int, list[Steps]]:
        """Sample other steps of some stops, best balanced first, whose last motions begin where the arms are clear."""
        sampled = {stop: self._factors.other_steps(self._step, stop) for stop in stops}
        if not sampled:
            return {}
        begins = {
            name: np.concatenate([q[stop] - steps[name] for stop, steps in sampled.items()])
            for name, q in self._q.items()
        }
        free = np.split(clear_stops(self._finder.cell, begins), len(sampled))
        return {
            stop: [{name: rows[k] for name, rows in steps.items()} for k in np.flatnonzero(of_stop).tolist()]
            for (stop, steps), of_stop in zip(sampled.items(), free, strict=True)
        }

    def _ask(self, motions: Iterable[tuple[int, Configuration | None, Steps]]) -> None:
        """Ask the gate in one batch about motions to stops, each with its beginning and its steps."""
        both = list[tuple[Configuration, Configuration]]()
        for stop, here, steps in motions:
            begin = self._begin_of(stop, steps)
            both.append((begin, self._at(stop)))
            both += [] if here is None else [(here, begin)]
        self._finder.gate.ask(both)

    def _accepts(self, stop: int, steps: Steps) -> bool:
        """Return whether the gate accepts other steps at a stop that is reached by a straight motion."""
        self._ask([(stop, self._before[stop], steps)])
        return self._is_free(stop, self._before[stop], steps)

    def _is_free(self, stop: int, here: Configuration | None, steps: Steps) -> bool:
        """Return whether the gate accepts both motions to a stop from where the arms are."""
        return self._last_is_free(stop, steps) and self._way_is_free(stop, here, steps)

    def _last_is_free(self, stop: int, steps: Steps) -> bool:
        """Return whether the gate accepts the last motion, and that of the repeat from the other side."""
        there, free = self._at(stop), self._finder.gate.free
        if not free(self._begin_of(stop, steps), there):
            return False
        mirrored = {name: -step for name, step in steps.items()}
        repeated = np.any(self._arrangement.repeat_of == stop)
        return not repeated or free(self._begin_of(stop, mirrored), there)

    def _way_is_free(self, stop: int, here: Configuration | None, steps: Steps) -> bool:
        return here is None or self._finder.gate.free(here, self._begin_of(stop, steps))

    def _begin_of(self, stop: int, steps: Steps) -> dict[str, Array]:
        return {name: q[stop] - steps[name] for name, q in self._q.items()}

    def _at(self, stop: int) -> dict[str, Array]:
        return {name: q[stop] for name, q in self._q.items()}

    def _set(self, stop: int, steps: Steps) -> None:
        copies = np.flatnonzero(self._arrangement.repeat_of == stop)
        for name, step in steps.items():
            self._step[name][copies] = -step
            self._step[name][stop] = step


# -- Repair of the order of stops where the gate refuses a straight motion, or a block ends: parts are moved -----------


_DETOUR_STEPS = 1.0
"""Cost of a detour, in mean steps."""
_ROUNDS = 2
"""One repair may make another one possible."""
_MOST_TRIED = 12
"""Orders that are compared for one stop, the fastest ones: the gate accepts about one in two."""
_ASKED_TOGETHER = 4
"""Of these, orders that the gate is asked about at once."""
_MOVES: tuple[tuple[Literal["reverse", "shift", "exchange"], int], ...] = (
    ("shift", 1),
    ("shift", -1),
    ("reverse", 0),
    ("exchange", 0),
)
"""Moves of a part of the order that begins or ends at a stop."""


def repair_order(
    stops: StopSet,
    now: Arrangement,
    start: Configuration | None,
    end: Configuration | None,
    gate: FreeMotions,
    job: JobToken,
) -> Arrangement:
    """Find an order of the same pairs of stops in which the gate refuses few straight motions, or none.

    Stops stay in their blocks. ``start`` and ``end`` are where the arms are before and after (None: anywhere).
    """
    n, detour_s = now.rows.shape[1], _DETOUR_STEPS * stops.usual_step_s
    order = np.arange(n + 2)  # 0 is the start, n + 1 the end
    at: list[Configuration | None] = [start, *(stops.at(rows) for rows in now.rows.T), end]
    free: dict[tuple[int, int], bool] = {}

    def refused(orders: Iterable[NDArray[np.intp]]) -> list[list[int]]:
        """Return for each part of an order the places before which the gate refuses a motion; it is asked one way."""
        ways = [[(min(way), max(way)) for way in pairwise(one.tolist())] for one in orders]
        new = {way: (at[way[0]], at[way[1]]) for own in ways for way in own if way not in free}
        motions = {way: (here, there) for way, (here, there) in new.items() if here is not None and there is not None}
        gate.ask(motions.values())
        free.update({way: way not in motions or gate.free(*motions[way]) for way in new})
        return [[place for place, way in enumerate(own) if not free[way]] for own in ways]

    ends = (np.flatnonzero(np.diff(now.block)) + 1).tolist()
    for place in (
        min(max(one - k, 0), n - 1) for _ in range(_ROUNDS) for one in (*refused([order])[0], *ends) for k in (0, 1)
    ):
        job.check()
        first, last = np.flatnonzero(now.block == now.block[place])[[0, -1]].tolist()
        part = order[first : last + 3]  # only motions to, in and from the block change
        others, seconds = _moved(stops, now.rows, part, place - first + 1)
        best, least_s = part, seconds[0] + detour_s * len(refused([part])[0])
        likely = np.argsort(seconds, kind="stable")[:_MOST_TRIED]
        for some in np.array_split(likely, range(_ASKED_TOGETHER, len(likely), _ASKED_TOGETHER)):
            hopeful = some[seconds[some] < least_s]  # others cost more, whatever the gate says
            for k, detours in zip(hopeful.tolist(), refused(others[hopeful]), strict=True):
                if seconds[k] + detour_s * len(detours) < least_s:
                    best, least_s = others[k], seconds[k] + detour_s * len(detours)
        order[first : last + 3] = best
    return now.taken(order[1:-1] - 1)


def _moved(
    stops: StopSet, rows: NDArray[np.intp], part: NDArray[np.intp], place: int
) -> tuple[NDArray[np.intp], Array]:
    """Return orders (m, k) of stops ``rows`` (K, n), counted from 1, and their times (m,) [s] without start and end.

    The first is ``part`` (k,); in the others, what begins or ends at ``place`` is moved.
    """
    k, n = len(part), rows.shape[1]
    other = np.arange(1, k - 1)[:, None]
    low, high = np.minimum(place, other), np.maximum(place, other)
    source = np.concatenate([Move(kind, low, high, shift).source(np.arange(k)) for kind, shift in _MOVES])
    source = np.concatenate([np.arange(k)[None], source])
    at = rows[:, np.clip(part - 1, 0, n - 1)]
    step_s = stops.step_s(np.repeat(at, k, axis=1), np.tile(at, k)).reshape(k, k)
    outside = (part < 1) | (part > n)
    step_s[outside] = step_s[:, outside] = 0.0
    return part[source], step_s[source[:, :-1], source[:, 1:]].sum(axis=1)
