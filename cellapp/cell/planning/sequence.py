"""From the chosen stops of each arm to a plan: pairs, order, factors and paths; the gate accepts every motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.planning.arrangement import arrange, block_count
from cellapp.cell.planning.factors import FactorPlan
from cellapp.cell.planning.joint_draws import joint_ranges
from cellapp.cell.planning.legs import LegPlanner
from cellapp.cell.planning.order_repair import repair_order
from cellapp.cell.planning.planned_stops import Configuration, PlannedStops, can_go, joined_after
from cellapp.cell.planning.stop_set import StopSet
from cellapp.cell.planning.transit_paths import TransitPlanner
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.safety.gate import CellBodies, refuse_motion
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore
from cellapp.robot.kinematics.transforms import Array

_JOB = "order"
_LARGEST_REPEATED_SHARE = 4
"""At most every fourth stop is a repeat."""
_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Sequenced:
    """A plan, and one sentence on each chosen configuration or stop that was given up, with the reason."""

    stops: PlannedStops
    given_up: tuple[str, ...]


def distinct_stops(profile: Profile, stops: int) -> int:
    """Return the number of different stops in a plan of ``stops`` stops; the others are repeats."""
    return stops - min(profile.plan.repeats, stops // _LARGEST_REPEATED_SHARE)


def sequenced(
    profile: Profile,
    cell: CellBodies,
    chosen: Mapping[str, Array],
    rng: np.random.Generator,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    after: Mapping[str, Array] | None = None,
    finder: TransitPlanner | None = None,
) -> Sequenced:
    """Pair the chosen stops of all arms, order them, plan their factors and paths.

    ``plan.stops`` and ``plan.reserve`` stops are planned, reserves last, or fewer if fewer are chosen. Further ones
    replace those that no motion reaches; ``plan.repeats`` stops are visited twice in place of others.

    Parameters
    ----------
    profile : Profile
    cell : CellBodies
    chosen : mapping
        Arm -> joint positions (n, N) [rad], the most important first. Joints may be planned at whole turns from these.
    rng : numpy.random.Generator
    listener, cancel
        Progress and cancelling.
    after : mapping, optional
        Arm -> stops (k, N) that exist already: the new ones begin at the last of them. As many stops are planned as are
        chosen, without reserves.
    finder : TransitPlanner, optional
        A planner of the same cell, whose cached answers are used; by default a new one.

    Raises
    ------
    InputError
        If no stop can be reached.
    Cancelled
    """
    homes = home_positions(profile)
    home: Configuration | None = homes if set(homes) == set(cell.arms) else None
    begun = after is not None and len(next(iter(after.values()))) > 0
    start = {name: q[-1] for name, q in after.items()} if begun and after is not None else home
    finder = finder or TransitPlanner(profile, cell, rng)
    job = _Job(profile, cell, home, finder, rng, listener, cancel or CancelToken(), [])
    q = {name: _reached(profile, cell, name, rows, job.finder, job.given_up) for name, rows in chosen.items()}
    if not min(map(len, q.values())):
        raise InputError(f"plan: none of the chosen stops can be reached. {' '.join(job.given_up[:1])}".strip())
    n = min(map(len, chosen.values()))
    if after is not None:
        planned = job.all_of(q, n, 0, start)
    else:
        reserve = min(profile.plan.reserve, n - 1)
        planned = job.all_of(q, min(n - reserve, profile.plan.stops), reserve, start)
    listener(Progress(_JOB, len(planned), len(planned), "done"))
    return Sequenced(planned, tuple(job.given_up))


def _reached(
    profile: Profile, cell: CellBodies, name: str, q: Array, finder: TransitPlanner, given_up: list[str]
) -> Array:
    """Select the configurations (m, N) that the arm alone can reach, in the turns in which they are planned."""
    turned = nearest_turns(profile, cell, name, q)
    reached = finder.roadmaps[name].reaches(turned)
    if not reached.all():
        alone, lost = replace(cell, arms={name: cell.arms[name]}), turned[np.argmin(reached)]
        reason = refuse_motion(alone, {name: finder.roadmaps[name].rest}, {name: lost})
        given_up.append(
            f"arm {name}: {np.sum(~reached)} of {len(q)} chosen configurations cannot be reached from home, the first:"
            f" {reason or 'within the allowance for sampled paths'}"
        )
    return turned[reached]


def nearest_turns(profile: Profile, cell: CellBodies, name: str, q: Array) -> Array:
    """Turn each joint by whole turns to be nearest to home, within the limits or ``plan.ranges``; poses stay the same.

    Many poses whose straight motion from home is blocked by the arm itself or by the floor are free in another turn.
    """
    home = profile.arms[name].home
    low, high = joint_ranges(cell, profile, name).T if profile.plan.ranges is not None else cell.arms[name].limits.T
    centre = 0.5 * (low + high) if home is None else np.array(home)
    near = centre + np.remainder(q - centre + 0.5 * _TURN, _TURN) - 0.5 * _TURN
    near = np.where(near < low, near + _TURN, np.where(near > high, near - _TURN, near))
    return np.asarray(np.where((near >= low) & (near <= high), near, q))


@dataclass(frozen=True, eq=False)
class _Job:
    """State that the parts of a plan share."""

    profile: Profile
    cell: CellBodies
    home: Configuration | None
    finder: TransitPlanner
    rng: np.random.Generator
    listener: Listener
    cancel: CancelToken
    given_up: list[str]

    def all_of(self, q: Mapping[str, Array], asked: int, reserve: int, start: Configuration | None) -> PlannedStops:
        """Plan ``asked`` stops, with repeats, and reserves after them, as far as there are configurations for them."""
        usable = min(map(len, q.values()))
        repeats = asked - distinct_stops(self.profile, asked)
        distinct = min(asked - repeats, usable)
        repeats = min(repeats, distinct // (_LARGEST_REPEATED_SHARE - 1))
        first = self.part({name: rows[:distinct] for name, rows in q.items()}, repeats, start)
        if not min(reserve, usable - distinct):
            return first
        rest = {name: rows[distinct : min(distinct + reserve, usable)] for name, rows in q.items()}
        second = self.part(rest, 0, first.targets(len(first) - 1))
        return joined_after(first, second)

    def part(self, q: Mapping[str, Array], repeats: int, start: Configuration | None) -> PlannedStops:
        """Plan stops that follow ``start``; from the last one the arms can go home."""
        n = min(map(len, q.values())) + repeats

        def report(done: int, words: str) -> None:
            self.listener(Progress(_JOB, done, n, words))

        report(0, "pairs and order")
        least = min(map(len, q.values()))
        stops = StopSet(self.profile, self.cell, {name: rows[:least] for name, rows in q.items()})
        arrangement = arrange(stops, block_count(self.profile.plan.blocks, n), repeats, self.rng, self.cancel)
        arrangement = repair_order(stops, arrangement, start, self.home, self.finder.gate, self.cancel)
        at = stops.at(arrangement.rows)
        factors = FactorPlan(self.profile, self.cell, at, arrangement.block, arrangement.repeat_of, self.rng)
        legs = LegPlanner(self.cell, at, arrangement, factors, self.finder, start)
        planned = legs.plan(report, self.cancel)
        self.given_up.extend(legs.given_up)
        while len(planned) and not (
            self.home is None or can_go(self.cell, planned.targets(len(planned) - 1), self.home)
        ):
            planned = planned.take(range(len(planned) - 1))
            self.given_up.append("the last stop has no way home")
        if not len(planned):
            reason = legs.given_up[0] if legs.given_up else "the arms cannot go home from it"
            raise InputError(f"plan: none of the chosen stops can be reached: {reason}")
        return planned
