"""Designed plans: candidates of each arm, the most informative of them, their factors, pairs, order and paths."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.planning.candidates import CandidatePool, draw_pool
from cellapp.cell.planning.planned_stops import PlannedStops, joined_after
from cellapp.cell.planning.selection import select_stops
from cellapp.cell.planning.sequence import nearest_turns, sequenced
from cellapp.cell.planning.transit_paths import TransitPlanner
from cellapp.cell.planning.within_reach import hubs_of, within_reach
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, sample_spacing
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore
from cellapp.robot.kinematics.transforms import Array

_SEED = 0xDE51
_SPARE_SHARE = 0.05
"""Share of stops chosen in reserve: in a crowded cell about one chosen stop in fifty cannot be reached."""
_LEAST_SPARES = 8
_ROUNDS = 3
"""Rounds in which spare stops replace those that cannot be reached."""
_LEAST_CHOICE = 3
"""Least number of easily reached candidates for each stop; with fewer there would be no choice."""
_SAMPLE = 1000
"""Number of candidates whose reach is checked first."""
_FEW_HARD = 0.01
"""Share of these up to which the others are not checked: spare stops replace the few hard ones that are chosen."""


@dataclass(frozen=True, eq=False)
class DesignedStops:
    """A designed plan, why each chosen stop that is missing was given up, candidates by arm, the path planner."""

    stops: PlannedStops
    given_up: tuple[str, ...]
    pools: Mapping[str, CandidatePool]
    finder: TransitPlanner


def design_stops(
    profile: Profile,
    count: int,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    kept: PlannedStops | None = None,
) -> DesignedStops:
    """Design ``count`` informative stops in a safe order, after those that are ``kept``.

    Parameters
    ----------
    profile : Profile
    count : int
        Number of further stops, reserves included.
    listener, cancel
        Progress and cancelling.
    kept : PlannedStops, optional
        Stops that are in the plan already: their information counts before the first choice.

    Raises
    ------
    InputError
        If an arm has no candidates, or none of them can be reached.
    Cancelled
    """
    cancel = cancel or CancelToken()
    cell = cell_bodies(profile)
    # the gate samples motions: a configuration at the very limit could not be reached
    roomy = replace(cell, clearance=cell.clearance + 0.5 * sample_spacing(cell))
    before = 0 if kept is None else len(kept)
    rng = np.random.default_rng([profile.seed, _SEED, before])
    pools = {}
    for number, name in enumerate(cell.arms):
        listener(Progress("candidates", number, len(cell.arms), f"arm {name}"))
        pools[name] = _pool(profile, roomy, name, count, rng, cancel)
    spares = max(_LEAST_SPARES, math.ceil(_SPARE_SHARE * count))  # for stops that cannot be reached from the others
    rows = select_stops(profile, pools, count + spares, rng, listener, cancel, None if kept is None else kept.q)
    chosen = {name: pool.q[rows[name]] for name, pool in pools.items()}
    finder = TransitPlanner(profile, cell, rng)
    return DesignedStops(*_in_order(profile, cell, chosen, count, kept, finder, rng, listener, cancel), pools, finder)


def _in_order(
    profile: Profile,
    cell: CellBodies,
    chosen: Mapping[str, Array],
    count: int,
    kept: PlannedStops | None,
    finder: TransitPlanner,
    rng: np.random.Generator,
    listener: Listener,
    cancel: CancelToken,
) -> tuple[PlannedStops, tuple[str, ...]]:
    """Return the kept stops and ``count`` more, beginning with the first ``chosen``, and why others were given up.

    Spare stops replace those that cannot be reached. Raises ``InputError`` if fewer than the asked stops can be
    reached.
    """
    stops = kept
    given_up: list[str] = []
    first = 0
    wanted = count + (0 if kept is None else len(kept))
    later = profile.plan.model_copy(update={"repeats": 0})
    for plan in (profile.plan, *[later] * _ROUNDS):
        missing = wanted - (0 if stops is None else len(stops))
        part = {name: q[first : first + missing] for name, q in chosen.items()}
        first += missing
        if missing and all(len(q) for q in part.values()):
            here = None if stops is None or not len(stops) else stops.q
            more = sequenced(profile.model_copy(update={"plan": plan}), cell, part, rng, listener, cancel, here, finder)
            given_up += more.given_up
            stops = more.stops if stops is None or not len(stops) else joined_after(stops, more.stops)
    reached = 0 if stops is None else len(stops)
    if stops is None or reached < wanted - profile.plan.reserve:
        reason = f". {given_up[0]}" if given_up else ""
        raise InputError(
            f"plan: only {reached} of {counted(wanted, 'stop')} can be reached; ask for fewer stops, a smaller"
            f" plan.clearance, or move bases, tracker or obstacles{reason}"
        )
    return stops, tuple(given_up)


def _pool(
    profile: Profile, cell: CellBodies, name: str, count: int, rng: np.random.Generator, cancel: CancelToken
) -> CandidatePool:
    """Draw candidates of an arm and keep those within easy reach. All are kept if these are too few for ``count``
    stops; only the first ones are checked if hardly any of them is hard to reach."""
    pool = draw_pool(cell, profile, name, max(profile.plan.pool_size, count), rng, cancel)
    q = nearest_turns(profile, cell, name, pool.q)
    hubs = hubs_of(cell, name, q, home_positions(profile).get(name))
    reached = np.ones(len(q), dtype=np.bool_)
    reached[:_SAMPLE] = within_reach(cell, name, q[:_SAMPLE], hubs)
    if np.mean(reached[:_SAMPLE]) < 1.0 - _FEW_HARD:
        reached[_SAMPLE:] = within_reach(cell, name, q[_SAMPLE:], hubs)
    if int(reached.sum()) < _LEAST_CHOICE * count:
        return replace(pool, q=q)
    rejected = {**pool.rejected, "hard to reach": int(np.sum(~reached))}
    return CandidatePool(q[reached], pool.incidence[reached], pool.drawn, rejected)
