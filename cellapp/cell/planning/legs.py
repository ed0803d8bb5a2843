"""Last motions and paths of an arrangement of stops: where the gate refuses, other sides and steps, or a detour."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from cellapp.cell.planning.arrangement import Arrangement
from cellapp.cell.planning.factors import FactorPlan
from cellapp.cell.planning.planned_stops import Configuration, PlannedStops, Route, straight_stops
from cellapp.cell.planning.transit_paths import TransitPlanner
from cellapp.cell.safety.gate import CellBodies, clear_stops
from cellapp.ground.progress import CancelToken, Report
from cellapp.robot.kinematics.transforms import Array

_MOST_WAYS = 6
"""Number of sides and steps of one stop for which the gate is asked about the motion to it. If it refuses all, the stop
itself is hard to reach, and a detour is sought."""
_REPORT_EVERY = 10
"""Stops between two reports of progress."""
_AHEAD = 100
"""Number of stops that are looked ahead: for those whose motions the gate refuses, other steps are drawn and asked
about in one batch. Few, as steps that are drawn together do not balance each other."""

Steps = Mapping[str, Array]
"""Arm -> signed steps of the last motion to one stop (N,) [rad]."""


class LegPlanner:
    """Plan of how each stop is reached from the one before it; ``start`` (None: anywhere) is before the first."""

    def __init__(
        self,
        cell: CellBodies,
        q: Mapping[str, Array],
        arrangement: Arrangement,
        factors: FactorPlan,
        finder: TransitPlanner,
        start: Configuration | None,
    ) -> None:
        self._cell, self._q, self._arrangement = cell, q, arrangement
        self._factors, self._finder, self._start = factors, finder, start
        self._step = factors.approaches()
        self._before: dict[int, Configuration | None] = {}
        """Where the arms are before each stop that is reached."""
        self._others: dict[int, list[Steps]] = {}
        """Other steps of the next stops."""
        self.given_up: list[str] = []
        """One sentence for each stop that cannot be reached."""

    def plan(self, report: Report, cancel: CancelToken) -> PlannedStops:
        """Plan the stops that can be reached, in their order."""
        n = len(self._arrangement.block)
        self._ask((stop, self._planned_before(stop), self._own(stop)) for stop in range(n))
        legs: dict[int, Route] = {}
        here = self._start
        for stop in range(n):
            cancel.check()
            if stop % _REPORT_EVERY == 0:
                report(stop, "ways")
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
            approach_from={name: _begin(q, self._step[name]) for name, q in self._q.items()},
            dwell_s=self._factors.dwell_s(self._step),
            block=self._arrangement.block,
            repeat_of=self._arrangement.repeat_of,
        )
        return replace(whole.take(list(legs)), legs=tuple(legs.values()))

    def _look_ahead(self, stops: range) -> None:
        """Draw other steps of stops whose planned motions the gate refuses, and ask about the first of each."""
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
        found = self._finder.find(here, self._begin_of(stop, usable))
        return found if isinstance(found, str) else found.legs

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
        """Draw other steps of some stops, best balanced first, whose last motions begin where the arms are clear."""
        drawn = {stop: self._factors.other_steps(self._step, stop) for stop in stops}
        if not drawn:
            return {}
        begins = {
            name: np.concatenate([q[stop] - steps[name] for stop, steps in drawn.items()])
            for name, q in self._q.items()
        }
        free = np.split(clear_stops(self._cell, begins), len(drawn))
        return {
            stop: [{name: rows[k] for name, rows in steps.items()} for k in np.flatnonzero(of_stop).tolist()]
            for (stop, steps), of_stop in zip(drawn.items(), free, strict=True)
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


def _begin(q: Array, step: Array) -> Array:
    """Compute where the last motions begin (n, N) [rad]; NaN where no joint moves."""
    return np.where(np.any(step != 0.0, axis=1, keepdims=True), q - step, np.nan)
