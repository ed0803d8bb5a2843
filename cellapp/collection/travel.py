"""Ways between stops: straight, via home, back out of a motion that was cut short; slow at first on real hardware."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations

from cellapp.collection.motion import MotionRefused, Mover, Vector
from cellapp.collection.work import Work
from cellapp.planning.stop_conditions import StopConditions
from cellapp.profile import Profile
from drivers.arms.protocol import ArmState

Targets = Mapping[str, Vector]
"""Arm -> joint positions (N,) [rad]."""


class Travel:
    """Moves the arms of one session to stops and home."""

    def __init__(self, profile: Profile, mover: Mover, work: Work) -> None:
        self._mover, self._work = mover, work
        self._settings = profile.collection.slow_start
        self._real = profile.moves_hardware
        self._slow_stops = 0
        self.slow_again()

    def slow_again(self) -> None:
        """Visit the next stops slowly: at the beginning, and after persons were called. On real hardware only."""
        self._slow_stops = self._settings.stops if self._real else 0
        self._mover.speed = self._settings.speed if self._slow_stops else 1.0

    def stop_visited(self) -> None:
        """Count a stop that was visited."""
        self._slow_stops = max(self._slow_stops - 1, 0)
        if not self._slow_stops:
            self._mover.speed = 1.0

    def to_stop(self, stop: int) -> dict[str, ArmState]:
        """Move to a stop as planned or proposed. Raises ``MotionRefused`` if the gate accepts no way."""
        targets = self._work.targets(stop)
        if stop not in self._work.proposed:
            return self.to(targets)
        return self._as_proposed(targets, self._work.proposed[stop])

    def to(self, targets: Targets) -> dict[str, ArmState]:
        """Move straight, or via home if the gate refuses that (after a resume, or a missed stop)."""
        try:
            return self._mover.move(targets)
        except MotionRefused:
            self.home()
            return self._mover.move(targets)

    def home(self) -> None:
        """Move home, one arm after the other.

        If that is refused after a motion that was cut short, the arms move back to where it began first.
        """
        try:
            self._mover.go_home()
        except MotionRefused:
            departure = self._mover.departure()
            if departure is None:
                raise
            self._mover.move(departure)
            self._mover.go_home()

    def home_at_once(self, homes: Targets) -> None:
        """Move all arms home at once, or one after the other if the gate refuses that."""
        try:
            self._mover.move(homes)
        except MotionRefused:
            self.home()

    def _as_proposed(self, targets: Targets, conditions: Mapping[str, StopConditions]) -> dict[str, ArmState]:
        """Move to where the last legs begin, all arms at once or one after the other, then do those legs.

        Nothing moves unless the gate accepts all legs. If it does not, the arms go home and try from there.
        """
        vias = {name: one.via for name, one in conditions.items() if one.via is not None and name in targets}
        start, last = {**targets, **vias}, {name: targets[name] for name in vias}
        orders: list[list[Targets]] = [[start]]
        orders += [[{name: start[name]} for name in order] for order in permutations(start)]
        routes = [[*legs, last] if last else legs for legs in orders]
        for at_home in (False, True):
            if at_home:
                self.home()
            for legs in routes:
                if not self._mover.refusal(*legs):
                    states: dict[str, ArmState] = {}
                    for leg in legs:
                        states |= self._mover.move(leg)
                    return states
        raise MotionRefused(f"refused to move: {self._mover.refusal(*routes[0])}")
