"""From the chosen stops of each arm to a plan: pairs, order, factors and ways, each motion accepted by the gate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.planning.arrangement import Arrangement, arrange, block_count
from cellapp.planning.factors import Approaches, FactorPlan
from cellapp.planning.joint_draws import joint_ranges
from cellapp.planning.order_repair import mend_order
from cellapp.planning.planned_stops import Configuration, PlannedStops, Route, joined
from cellapp.planning.stop_set import StopSet
from cellapp.planning.ways import WayFinder
from cellapp.profile import Profile
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.safety.cell_bodies import home_positions
from cellapp.safety.gate import CellBodies, refuse_motion

_JOB = "order"
_LARGEST_REPEATED_SHARE = 4
"""At most every fourth stop is a repeat."""
_TURN = 2.0 * np.pi
_PROGRESS_EVERY = 10
"""Stops between two progress reports."""


def distinct_stops(profile: Profile, stops: int) -> int:
    """Number of different stops of a plan of some stops; the others are repeats."""
    return stops - min(profile.plan.repeats, stops // _LARGEST_REPEATED_SHARE)


def sequence_stops(
    profile: Profile,
    cell: CellBodies,
    chosen: Mapping[str, Array],
    rng: np.random.Generator,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    after: Mapping[str, Array] | None = None,
) -> PlannedStops:
    """Pair the chosen stops of all arms, order them, plan their factors and ways.

    As many stops are planned as are chosen. ``plan.repeats`` of them are repeats; the last chosen ones are left out
    for them. The last ``plan.reserve`` stops are reserves, planned like the others after them.

    Parameters
    ----------
    profile : Profile
    cell : CellBodies
    chosen : mapping
        Arm -> joint positions (n, N) [rad], the most important first. A joint may be planned whole turns from there.
    rng : numpy.random.Generator
    listener, cancel
        Progress and cancelling.
    after : mapping, optional
        Arm -> stops (k, N) that exist already: the way begins at the last one, and there are no reserves.

    Raises
    ------
    InputError
        If no stop can be reached.
    Cancelled
    """
    cancel = cancel or CancelToken()
    n = min(len(q) for q in chosen.values())
    homes = home_positions(profile)
    home: Configuration | None = homes if set(homes) == set(cell.arms) else None
    start = home if after is None or not len(next(iter(after.values()))) else {k: q[-1] for k, q in after.items()}
    reserve = 0 if after is not None else min(profile.plan.reserve, n - 1)
    asked = n - reserve
    distinct = distinct_stops(profile, asked)
    turned = {name: nearest_turns(profile, cell, name, q) for name, q in chosen.items()}
    job = _Job(profile, cell, home, rng, listener, cancel)
    first = job.part({name: q[:distinct] for name, q in turned.items()}, asked - distinct, start)
    if not reserve:
        return first
    rest = {name: q[distinct : distinct + reserve] for name, q in turned.items()}
    second = job.part(rest, 0, first.targets(len(first) - 1))
    both = joined(first, replace(second, block=second.block + first.block[-1] + 1))
    return replace(both, legs=(*first.legs, *second.legs))


def nearest_turns(profile: Profile, cell: CellBodies, name: str, q: Array) -> Array:
    """The same poses with each joint in the turn nearest to home, within the limits or ``plan.ranges``.

    Many poses whose straight way from home is blocked by the arm itself, or by the floor, are free in another turn.
    """
    home = profile.arms[name].home
    low, high = joint_ranges(cell, profile, name).T if profile.plan.ranges is not None else cell.arms[name].limits.T
    centre = 0.5 * (low + high) if home is None else np.array(home)
    near = centre + np.remainder(q - centre + 0.5 * _TURN, _TURN) - 0.5 * _TURN
    near = np.where(near < low, near + _TURN, np.where(near > high, near - _TURN, near))
    return np.asarray(np.where((near >= low) & (near <= high), near, q))


@dataclass(frozen=True, eq=False)
class _Job:
    """What the parts of a plan share."""

    profile: Profile
    cell: CellBodies
    home: Configuration | None
    rng: np.random.Generator
    listener: Listener
    cancel: CancelToken

    def part(self, q: Mapping[str, Array], repeats: int, start: Configuration | None) -> PlannedStops:
        """Plan stops that follow ``start``; after the last one the arms can go home."""
        n = len(next(iter(q.values()))) + repeats
        self.listener(Progress(_JOB, 0, n, "pairs and order"))
        stops = StopSet(self.profile, self.cell, q)
        arrangement = arrange(stops, block_count(self.profile.plan.blocks, n), repeats, self.rng, self.cancel)
        arrangement = mend_order(stops, arrangement, start, self.home, self.cancel)
        return _Legs(self, stops, arrangement, start).plan()


class _Legs:
    """Approaches and ways of an arrangement, stop by stop."""

    def __init__(self, job: _Job, stops: StopSet, arrangement: Arrangement, start: Configuration | None) -> None:
        self._job, self._start = job, start
        self._q = stops.at(arrangement.rows)
        self._arrangement = arrangement
        self._factors = FactorPlan(job.profile, job.cell, self._q, arrangement.block, arrangement.repeat_of, job.rng)
        self._finder = WayFinder(job.profile, job.cell, job.rng)

    def plan(self) -> PlannedStops:
        """The stops that can be reached, in their order."""
        n = len(self._arrangement.block)
        approaches = self._factors.approaches()
        legs: list[Route] = []
        kept: list[int] = []
        here = self._start
        for stop in range(n):
            self._job.cancel.check()
            if stop % _PROGRESS_EVERY == 0:
                self._job.listener(Progress(_JOB, stop, n, "ways"))
            way = self._way(approaches, stop, here)
            if way is not None:
                kept.append(stop)
                legs.append(way)
                here = {name: q[stop] for name, q in self._q.items()}
        self._job.listener(Progress(_JOB, n, n, "done"))
        if not kept:
            raise InputError("plan: none of the chosen stops can be reached; ask for a smaller plan.clearance")
        dwell_s = self._factors.dwell_s()
        whole = PlannedStops(
            q=self._q,
            approach_from={name: _start_of(q, approaches.step[name]) for name, q in self._q.items()},
            dwell_s=dwell_s,
            legs=((),) * n,
            block=self._arrangement.block,
            repeat_of=self._arrangement.repeat_of,
            frozen=np.zeros(n, dtype=np.bool_),
        )
        return replace(whole.take(kept), legs=tuple(legs))

    def _way(self, approaches: Approaches, stop: int, here: Configuration | None) -> Route | None:
        """Legs to a stop; its steps are changed where the gate refuses. None if it cannot be reached."""
        there = {name: q[stop] for name, q in self._q.items()}
        copies = np.flatnonzero(self._arrangement.repeat_of == stop).tolist()
        patterns = [{name: step[stop].copy() for name, step in approaches.step.items()}]
        usable: dict[str, Array] | None = None
        tried = 0
        while tried < len(patterns):
            steps = patterns[tried]
            begin = {name: there[name] - step for name, step in steps.items()}
            back = {name: there[name] + step for name, step in steps.items()}
            tried += 1
            last_free = not refuse_motion(self._job.cell, begin, there) and not (
                copies and refuse_motion(self._job.cell, back, there)
            )
            if last_free and (here is None or not refuse_motion(self._job.cell, here, begin)):
                self._set(approaches, stop, copies, steps)
                return ()
            if last_free and usable is None:
                usable = steps
            if tried == 1 and self._arrangement.repeat_of[stop] < 0:
                patterns += self._factors.other_patterns(approaches, stop)
        if usable is None:
            usable = {name: np.zeros_like(step) for name, step in patterns[0].items()}
        self._set(approaches, stop, copies, usable)
        if here is None:
            return ()
        found = self._finder.find(here, {name: there[name] - step for name, step in usable.items()})
        return None if isinstance(found, str) else found.legs

    def _set(self, approaches: Approaches, stop: int, copies: list[int], steps: Mapping[str, Array]) -> None:
        for name, step in steps.items():
            approaches.step[name][stop] = step
            approaches.step[name][copies] = -step


def _start_of(q: Array, step: Array) -> Array:
    """Where the last motions begin (n, N) [rad]; NaN where no joint moves."""
    return np.where(np.any(step != 0.0, axis=1, keepdims=True), q - step, np.nan)
