"""Stops to collect in a run: planned ones, proposed ones, reserves for those that cannot be measured, and stops to be
measured again.

Motions between stops: as planned or by another route, via home, back after an interrupted motion; slow at first on
real hardware.

Joint positions that the arms' controllers forbid, queried before anything moves.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.driving.motion import MotionRefused, Mover, Targets, Vector
from cellapp.cell.planning.planned_stops import PlannedStops, Route, read_planned_stops, routes
from cellapp.cell.run import RunFile
from cellapp.ground.counting import counted
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.shell import shell_word
from drivers.arms.protocol import ArmState


@dataclass(frozen=True)
class StopsToCollect:
    """The stops to collect.

    Attributes
    ----------
    route : PlannedStops
        All stops of the plan, with the motions that lead to them.
    stops : tuple of int
        Indices of the stops that are not stored, without reserves.
    reserves : tuple of int
        Indices of the reserve stops that are not stored.
    stored : int
        Number of stored stops.
    proposed : frozenset of int
        Indices of the stops that discovery proposed.
    split : str or None
        Split of new readings; None if splits are not sampled yet.
    earlier_s : float
        Time of the last stored reading [s]; new readings come after it.
    again : bool
        Whether ``stops`` were tried before and are measured again: new readings replace the earlier ones.
    """

    route: PlannedStops
    stops: tuple[int, ...]
    reserves: tuple[int, ...]
    stored: int
    proposed: frozenset[int]
    split: str | None
    earlier_s: float
    again: bool = False

    @property
    def total(self) -> int:
        """Number of stored stops plus stops to collect, without reserves."""
        return self.stored + len(self.stops)

    @property
    def loads(self) -> tuple[int, ...]:
        """Indices of the loads of the stops to collect, ascending."""
        return tuple(sorted({int(self.route.load[stop]) for stop in self.stops}))

    def with_load(self, load: int) -> StopsToCollect:
        """Return the part of the work with one load; reserves stay, whatever their load."""
        return replace(self, stops=tuple(stop for stop in self.stops if self.route.load[stop] == load))

    def dwell_s(self, stop: int, name: str) -> float:
        """Return the shortest rest of an arm at a stop before it is measured [s]."""
        return float(self.route.dwell_s[name][stop])


def remaining_work(run: RunFile, *, resume: bool) -> StopsToCollect:
    """Return the remaining work. Raise ``InputError`` without a plan, or if stops are stored and not ``resume``."""
    route = read_planned_stops(run)
    if not len(route):
        raise InputError(f"{run.path}: there is no plan; make one with 'cellapp plan PROFILE --run NEW'")
    done = run.stops_done()
    if done and not resume:
        raise InputError(
            f"{run.path}: {counted(len(done), 'stop is', 'stops are')} stored already; continue with --resume, or"
            " start a new run"
        )
    total = len(route)
    readings = [run.readings(name) for name in run.arms()]
    sampled = any(arm.split is not None for arm in readings)
    reserves = run.profile.plan.reserves(total)
    return StopsToCollect(
        route=route,
        stops=tuple(stop for stop in range(total) if stop not in done and stop not in reserves),
        reserves=tuple(stop for stop in reserves if stop not in done),
        stored=len(done),
        proposed=frozenset(np.flatnonzero(route.proposed).tolist()),
        split="train" if sampled else None,
        earlier_s=max((float(arm.time_s.max()) for arm in readings), default=0.0) if done else 0.0,
    )


def work_again(run: RunFile, stops: Collection[int]) -> StopsToCollect:
    """Return the work of measuring stops again, as they were planned; nothing else is visited.

    Raises
    ------
    InputError
        Without a plan, without stops, or if one of them does not exist or was not tried yet.
    """
    work = remaining_work(run, resume=True)
    tried = run.stops_done() | {one.stop for one in run.outcomes()}
    if not stops:
        raise InputError(f"{run.path}: no stop is named to be measured again")
    if unknown := [stop for stop in sorted(stops) if not 0 <= stop < len(work.route)]:
        raise InputError(f"{run.path}: there is no stop {unknown[0] + 1}; there are 1 to {len(work.route)}")
    if untried := [stop for stop in sorted(stops) if stop not in tried]:
        raise InputError(
            f"{run.path}: stop {untried[0] + 1} was not measured yet; 'cellapp collect {shell_word(run.folder)}"
            " --resume' measures"
            " what is left"
        )
    return replace(work, stops=tuple(sorted(stops)), reserves=(), stored=0, again=True)


class StopQueue:
    """Queue of the stops to visit; reserves and stops to be tried again are appended."""

    def __init__(self, work: StopsToCollect) -> None:
        self._waiting = deque(work.stops)
        self._reserves = deque(work.reserves)
        self._deferred: set[int] = set()
        self.finished = work.stored
        """Number of stops stored or given up."""
        self.total = work.total
        """Number of stops that are finished or will be visited."""

    def next(self) -> int | None:
        """Return the next stop; None at the end. It stays in the queue until ``done`` or ``defer``."""
        return self._waiting[0] if self._waiting else None

    def done(self) -> None:
        """Remove the stop that was visited."""
        self._waiting.popleft()
        self.finished += 1

    def defer(self) -> bool:
        """Move the stop to the end of the queue, to be reached from another stop; return False if tried already."""
        stop = self._waiting[0]
        if stop in self._deferred or len(self._waiting) == 1:
            return False
        self._deferred.add(stop)
        self._waiting.append(self._waiting.popleft())
        return True

    def replace(self) -> int | None:
        """Append a reserve for a stop that could not be measured; return its index, None if none is left."""
        if not self._reserves:
            return None
        self.total += 1
        self._waiting.append(self._reserves.popleft())
        return self._waiting[-1]

    def remove(self, stops: set[int]) -> None:
        """Remove stops that must not be visited, also from the reserves."""
        self.finished += sum(stop in stops for stop in self._waiting)
        self._waiting = deque(stop for stop in self._waiting if stop not in stops)
        self._reserves = deque(stop for stop in self._reserves if stop not in stops)

    def close(self) -> None:
        """Give up the remaining stops: the requested accuracy is reached."""
        self._waiting.clear()
        self.total = self.finished


class Travel:
    """Moves the arms of one session to stops and home."""

    def __init__(self, mover: Mover, work: StopsToCollect) -> None:
        self._mover, self._work = mover, work
        self.slow_again()

    def slow_again(self) -> None:
        """Visit the next stops slowly (real hardware only): at the beginning, and after a person was called."""
        self._visited = 0
        self._mover.slow_start(0)

    def stop_visited(self) -> None:
        """Count a visited stop."""
        self._visited += 1
        self._mover.slow_start(self._visited)

    def to_stop(self, stop: int) -> dict[str, ArmState]:
        """Move to a stop: as planned, straight, one arm after the other, or each of these from home.

        Every route ends with the planned last motion, and begins only if the gate accepts all of its motions.

        Raises
        ------
        MotionRefused
            If the gate accepts no route.
        """
        try:
            return self._mover.along(self._routes(stop))
        except MotionRefused:
            self.home()
            return self._mover.along(self._routes(stop))

    def first_leg(self, stop: int) -> Targets:
        """Return where the first motion of ``to_stop`` leads from the present positions."""
        accepted = (route for route in self._routes(stop) if not self._mover.refusal(*route))
        return next(accepted, (self._mover.homes,))[0]

    def home(self) -> None:
        """Move home, one arm after the other.

        If the gate refuses that after an interrupted motion, first move back to where that motion began.
        """
        try:
            self._mover.go_home()
        except MotionRefused:
            if self._mover.departure is None:
                raise
            self._mover.move(self._mover.departure)
            self._mover.go_home()

    def home_at_once(self) -> None:
        """Move all arms home at once, or one after the other if the gate refuses that."""
        try:
            self._mover.move(self._mover.homes)
        except MotionRefused:
            self.home()

    def _routes(self, stop: int) -> list[Route]:
        """Return the routes to a stop from the present positions."""
        before = self._work.route.targets(stop - 1) if stop else self._mover.homes
        planned = bool(self._work.route.legs[stop]) and self._mover.rests_at(before)
        return list(routes(self._work.route, stop, as_planned=planned))

    def forbidden_stops(self) -> dict[int, str]:
        """Return the stops that a controller forbids, stop -> reason.

        The query covers all stops that are not stored, and the reserves, with the ends of their legs and the starts of
        their last motions. All controllers are queried concurrently: each needs some milliseconds per position.

        Raises
        ------
        HardwareError
            If a controller forbids a home position.
        CellStopped
            If one does not answer.
        """
        work, homes = self._work, self._mover.homes
        asked = {name: _positions(work, [*work.stops, *work.reserves], name) for name in work.route.q}
        q = {name: np.vstack([homes[name], *(at for _, at in positions)]) for name, positions in asked.items()}
        forbidden: dict[int, str] = {}
        for name, refused in self._mover.refused_by_controllers(q).items():
            if refused[0]:
                raise HardwareError(
                    f"arm {name}: the controller's safety limits forbid its home position; change arms.{name}.home, or"
                    " the safety limits on the pendant"
                )
            for row in np.flatnonzero(refused[1:]):
                stop = asked[name][row][0]
                forbidden.setdefault(stop, f"arm {name}: the controller's safety limits forbid these joint positions")
        return forbidden


def _positions(work: StopsToCollect, stops: Sequence[int], name: str) -> list[tuple[int, Vector]]:
    """Return the joint positions of an arm at stops and on the planned ways to them, each with its stop."""
    found = []
    for stop in stops:
        way = [*work.route.legs[stop], work.route.approach_starts(stop), work.route.targets(stop)]
        found += [(stop, motion[name]) for motion in way if name in motion]
    return found
