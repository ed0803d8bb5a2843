"""A complete plan in memory: stops of all arms in their order, how each is reached, and what it is for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.gate import CellBodies, refuse_motion
from cellapp.robot.kinematics.transforms import Array

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
    """

    q: Mapping[str, Array]
    approach_from: Mapping[str, Array]
    dwell_s: Mapping[str, Array]
    legs: tuple[tuple[Configuration, ...], ...]
    block: NDArray[np.intp]
    repeat_of: NDArray[np.intp]
    frozen: NDArray[np.bool_]
    load: NDArray[np.intp]

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
        return PlannedStops(
            q={name: q[chosen] for name, q in self.q.items()},
            approach_from={name: q[chosen] for name, q in self.approach_from.items()},
            dwell_s={name: rest[chosen] for name, rest in self.dwell_s.items()},
            legs=tuple(
                self.legs[row] if row == before + 1 else ()
                for before, row in zip([-1, *chosen.tolist()], chosen.tolist())
            ),
            block=self.block[chosen],
            repeat_of=place[self.repeat_of[chosen]],
            frozen=self.frozen[chosen],
            load=self.load[chosen],
        )


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
    )


def joined(first: PlannedStops, second: PlannedStops) -> PlannedStops:
    """Append the stops of ``second``, without legs to its first one; both plans have the same arms."""
    later = np.where(second.repeat_of < 0, -1, second.repeat_of + len(first))

    def both(before: Mapping[str, Array], after: Mapping[str, Array]) -> dict[str, Array]:
        return {name: np.concatenate([rows, after[name]]) for name, rows in before.items()}

    return PlannedStops(
        q=both(first.q, second.q),
        approach_from=both(first.approach_from, second.approach_from),
        dwell_s=both(first.dwell_s, second.dwell_s),
        legs=(*first.legs, *(((), *second.legs[1:]) if min(len(first), len(second)) > 0 else second.legs)),
        block=np.concatenate([first.block, second.block]),
        repeat_of=np.concatenate([first.repeat_of, later]),
        frozen=np.concatenate([first.frozen, second.frozen]),
        load=np.concatenate([first.load, second.load]),
    )


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
