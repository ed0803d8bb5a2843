"""Motions between stops: as planned or by another route, via home, back after an interrupted motion; slow at first on
real hardware."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cellapp.cell.driving.motion import MotionRefused, Mover, Vector
from cellapp.cell.driving.work import Work
from cellapp.cell.planning.planned_stops import Route, routes
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.ground.profile import Profile
from drivers.arms.protocol import ArmState

Targets = Mapping[str, Vector]
"""Arm -> joint positions (N,) [rad]."""


class Travel:
    """Moves the arms of one session to stops and home."""

    def __init__(self, profile: Profile, mover: Mover, work: Work) -> None:
        self._mover, self._work = mover, work
        self._homes: Targets = home_positions(profile)
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
            return self._by_any(self._routes(stop))
        except MotionRefused:
            self.home()
            return self._by_any(self._routes(stop))

    def first_leg(self, stop: int) -> Targets:
        """Return where the first motion of ``to_stop`` leads from the present positions."""
        accepted = (route for route in self._routes(stop) if not self._mover.refusal(*route))
        return next(accepted, (self._homes,))[0]

    def home(self) -> None:
        """Move home, one arm after the other.

        If the gate refuses that after an interrupted motion, first move back to where that motion began.
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

    def _routes(self, stop: int) -> list[Route]:
        """Return the routes to a stop from the present positions."""
        before = self._work.targets(stop - 1) if stop else self._homes
        planned = bool(self._work.route.legs[stop]) and self._mover.rests_at(before)
        return list(routes(self._work.route, stop, as_planned=planned))

    def _by_any(self, ways: Sequence[Route]) -> dict[str, ArmState]:
        """Move along the first route that the gate accepts. Raise the first ``MotionRefused`` if there is none."""
        first: MotionRefused | None = None
        for way in ways:
            try:
                return self._along(way)
            except MotionRefused as error:
                first = first or error
        assert first is not None
        raise first

    def _along(self, way: Route) -> dict[str, ArmState]:
        """Move along a route. Raise ``MotionRefused`` if the gate refuses one of its motions."""
        refusal = self._mover.refusal(*way) if len(way) > 1 else ""  # for a single motion, ``move`` checks
        if refusal:
            raise MotionRefused(f"refused to move: {refusal}")
        states: dict[str, ArmState] = {}
        for leg in way:
            states |= self._mover.move(leg)
        return states
