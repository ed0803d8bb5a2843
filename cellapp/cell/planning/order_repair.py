"""Repair of the order of stops where the gate refuses a straight motion: parts are reversed, shifted or exchanged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.arrangement import Arrangement
from cellapp.cell.planning.planned_stops import Configuration
from cellapp.cell.planning.stop_set import StopSet
from cellapp.cell.planning.tour import Move
from cellapp.cell.safety.many_motions import FreeMotions
from cellapp.ground.progress import CancelToken
from cellapp.robot.kinematics.transforms import Array

_DETOUR_STEPS = 1.0
"""Cost of a detour, in mean steps: an order that costs more than the detour is not taken."""
_MOST_TRIED = 12
"""Orders that the gate is asked about for one refused motion: it accepts about one in two."""
_ROUNDS = 2
"""Passes over all motions: one repair may make another one possible."""

_LEAST_GAIN_S = 0.02
"""Smallest gain [s] for which the order at the joint of two blocks is changed: each block was ordered by itself."""

_LONGEST_PART = 20
"""Largest number of stops that a move displaces: more would change when the postures of a block are visited."""


def repair_order(
    stops: StopSet,
    arrangement: Arrangement,
    start: Configuration | None,
    end: Configuration | None,
    gate: FreeMotions,
    cancel: CancelToken,
) -> Arrangement:
    """Find an order of the same pairs of stops in which the gate refuses few straight motions, or none.

    Stops stay in their blocks. ``start`` and ``end`` are where the arms are before and after (None: anywhere).
    """
    ways = _Ways(stops, start, end, gate)
    for place in [0, *(np.flatnonzero(np.diff(arrangement.block)) + 1).tolist(), len(arrangement.block)]:
        while (better := _better(ways, arrangement, place, -_LEAST_GAIN_S)) is not None:
            arrangement = better
    ways.ask((arrangement, place - 1, place) for place in range(arrangement.rows.shape[1] + 1))
    limit = _DETOUR_STEPS * stops.usual_step_s
    for _ in range(_ROUNDS):
        refused = 0
        for place in range(arrangement.rows.shape[1] + 1):
            cancel.check()
            if ways.is_free(arrangement, place - 1, place):
                continue
            refused += 1
            better = _better(ways, arrangement, place, limit)
            arrangement = arrangement if better is None else better
        if not refused:
            break
    return arrangement


def _better(ways: _Ways, now: Arrangement, place: int, limit: float) -> Arrangement | None:
    """Find an order that costs less than ``limit`` [s] and whose new motions are accepted; None if there is none."""
    costs: list[tuple[float, int, Move]] = []
    along = ways.along(now)
    for move in _moves(now.block, place):
        added = ways.added_s(along, move)
        costs += [(float(added[k]), k, move) for k in np.argsort(added, kind="stable")[:_MOST_TRIED].tolist()]
    costs.sort(key=lambda one: one[:2])
    positions = np.arange(1, now.rows.shape[1] + 1)
    tried = [
        Move(move.kind, move.low[k : k + 1], move.high[k : k + 1], _shift(move, k))
        for added_s, k, move in costs[:_MOST_TRIED]
        if added_s <= limit
    ]
    new = [[(now, int(before[0]) - 1, int(here[0]) - 1) for _, before, here in move.steps()] for move in tried]
    asked = 0
    for number, (move, of_move) in enumerate(zip(tried, new, strict=True)):
        if number == asked:  # about one in two is accepted
            asked = 2 * number + 2
            ways.ask(way for later in new[number:asked] for way in later)
        if all(ways.is_free(*way) for way in of_move):
            return now.taken(move.source(positions) - 1)
    return None


def _shift(move: Move, k: int) -> NDArray[np.intp] | int:
    return move.shift if isinstance(move.shift, int) else move.shift[k : k + 1]


def _moves(block: NDArray[np.intp], place: int) -> Iterator[Move]:
    """Yield moves within a block that change the motion to the stop at ``place``; positions count from 1."""
    here = place + 1
    if place < len(block):
        before, later = _beside(block, place)
        yield from _of_part(np.full_like(later, here), later)
        yield Move("exchange", before, np.full_like(before, here))
    if place > 0:
        before, later = _beside(block, place - 1)
        yield from _of_part(before, np.full_like(before, place))
        yield Move("exchange", np.full_like(later, place), later)


def _beside(block: NDArray[np.intp], place: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the positions before and after a stop, within its block and ``_LONGEST_PART``."""
    first, end = (int(np.searchsorted(block, block[place], side=side)) for side in ("left", "right"))
    before = np.arange(max(first, place - _LONGEST_PART) + 1, place + 1)
    return before, np.arange(place + 2, min(end, place + 1 + _LONGEST_PART) + 1)


def _of_part(low: NDArray[np.intp], high: NDArray[np.intp]) -> Iterator[Move]:
    yield Move("reverse", low, high)
    yield Move("exchange", low, high)
    yield Move("shift", low, high, np.ones_like(low))
    yield Move("shift", low, high, high - low)


Way = tuple[Arrangement, int, int]
"""The straight motion between two places of an arrangement; -1 is the start, n the end."""


class _Ways:
    """The straight motions between stops: their time, and whether the gate accepts them."""

    def __init__(
        self, stops: StopSet, start: Configuration | None, end: Configuration | None, gate: FreeMotions
    ) -> None:
        self._stops, self._start, self._end, self._gate = stops, start, end, gate

    def ask(self, ways: Iterable[Way]) -> None:
        """Ask the gate about several motions at once."""
        self._gate.ask(motion for way in ways if (motion := self._motion(*way)) is not None)

    def is_free(self, arrangement: Arrangement, before: int, place: int) -> bool:
        """Return whether the gate accepts a motion."""
        motion = self._motion(arrangement, before, place)
        return motion is None or self._gate.free(*motion)

    def _motion(self, arrangement: Arrangement, before: int, place: int) -> tuple[Configuration, Configuration] | None:
        """Return start and end of a motion; None if either is anywhere, or nothing moves."""
        here, there = self._at(arrangement, before), self._at(arrangement, place)
        return None if here is None or there is None or before == place else (here, there)

    def along(self, now: Arrangement) -> list[Array]:
        """Return the positions of each arm from start to end, NaN where start or end is None."""
        found = []
        for name, rows in zip(self._stops.names, now.rows, strict=True):
            q = self._stops.q[name][rows]
            nowhere = np.full(q.shape[1], np.nan)
            start, end = (nowhere if one is None else one[name] for one in (self._start, self._end))
            found.append(np.concatenate([start[None], q, end[None]]))
        return found

    def added_s(self, along: list[Array], move: Move) -> Array:
        """Compute the time (n,) [s] that each of the moves adds to the motions through the positions ``along``."""
        added: Array = np.zeros(len(move.low))
        for position, before, here in move.steps():
            added += self._time_s(along, before, here) - self._time_s(along, position - 1, position)
        return added

    def _time_s(self, along: list[Array], before: NDArray[np.intp], here: NDArray[np.intp]) -> Array:
        seconds = self._stops.way_s([q[here] - q[before] for q in along])
        return np.asarray(np.where(np.isfinite(seconds) & (here > 0), seconds, 0.0))

    def _at(self, arrangement: Arrangement, place: int) -> Configuration | None:
        if place < 0:
            return self._start
        return self._stops.at(arrangement.rows[:, place]) if place < arrangement.rows.shape[1] else self._end
