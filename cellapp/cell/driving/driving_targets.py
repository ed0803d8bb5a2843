"""Drive one or more arms to commands: straight, one after the other, or via home, never into a dead end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from cellapp.cell.driving.motion import MotionRefused, Mover, Vector
from drivers.arms.protocol import ArmState

Targets = Mapping[str, Vector]
"""Arm -> joint positions (N,) [rad]."""
Sides = Mapping[str, Vector]
"""Arm -> requested signs (N,) of each joint's last motion, 0 if it does not matter; arms left out have no request."""
CommandFrom = Callable[[str, Vector], Vector]
"""Function: arm and its joint positions (N,) [rad] before, which affect backlash -> its command (N,) [rad]."""

_STEPS_BACK_RAD = (np.radians(1.0), np.radians(0.25))
"""Step back of a joint that must arrive from a given side [rad]: well beyond any backlash, short enough to stay clear.
The second one is for arms that are close to something."""


@dataclass(frozen=True)
class Driver:
    """Drives arms to their commands; ``homes`` are the home positions of all arms."""

    mover: Mover
    homes: Targets

    def to(self, names: Sequence[str], command: CommandFrom, sides: Sides) -> dict[str, ArmState]:
        """Drive ``names`` to their commands from the given sides, the others home first. Return their states at rest.

        Only motions after which the arms can move home again are allowed.

        Raises
        ------
        MotionRefused
            If the gate accepts no way to the commands.
        CellStopped
            As ``Mover.move``.
        """
        q = self.mover.positions()
        away = [name for name in q if name not in names and not self.mover.rests_at({name: self.homes[name]})]
        if away:
            self.mover.go_home(away)
        way, refusal = self._accepted({name: command(name, q[name]) for name in names}, sides)
        if not way:
            self.mover.go_home(names)
            way, refusal = self._accepted({name: command(name, self.homes[name]) for name in names}, sides)
        return self._along(way, refusal)

    def back_to(self, targets: Targets, sides: Sides) -> dict[str, ArmState]:
        """Drive arms that are near ``targets`` to them, from the given sides. Return and raise as ``to``."""
        way, refusal = self._accepted(targets, sides)
        if not way:
            way, _ = self._accepted(targets, sides, _STEPS_BACK_RAD[1])
        return self._along(way, refusal)

    def _accepted(
        self, targets: Targets, sides: Sides, step_rad: float = _STEPS_BACK_RAD[0]
    ) -> tuple[list[Targets], str]:
        """Return the first way that the gate accepts together with a way home; if none, an empty list and why not."""
        legs = {name: [q] for name, q in targets.items()}
        if any(np.any(sides[name]) for name in targets if name in sides):
            legs = {name: [before_side(q, sides.get(name), step_rad), q] for name, q in targets.items()}
        first = ""
        for way in _ways(legs):
            for order in permutations(targets):
                refusal = self.mover.refusal(*way, *({name: self.homes[name]} for name in order))
                if not refusal:
                    return way, ""
                first = first or refusal
        return [], first

    def _along(self, way: Sequence[Targets], refusal: str) -> dict[str, ArmState]:
        if not way:
            raise MotionRefused(f"refused to move: {refusal}")
        states: dict[str, ArmState] = {}
        for leg in way:
            states |= self.mover.move(leg)
        return states


def before_side(q: Vector, sides: Vector | None, step_rad: float = _STEPS_BACK_RAD[0]) -> Vector:
    """Return the position (N,) [rad] before ``q`` (N,) from which each joint with a sign arrives on that side."""
    return q if sides is None else np.asarray(q - step_rad * sides)


def arrival(q: Vector, start: Vector, sides: Vector | None) -> Vector:
    """Return the position (N,) [rad] from which each joint arrives at ``q`` (N,), starting at ``start`` (N,)."""
    return start if sides is None else np.where(sides != 0, before_side(q, sides), start)


def _ways(legs: Mapping[str, Sequence[Vector]]) -> Iterator[list[Targets]]:
    """Yield all arms at once, then one after the other in every order; ``legs`` are the positions of each arm."""
    yield [dict(zip(legs, leg, strict=True)) for leg in zip(*legs.values(), strict=True)]
    if len(legs) > 1:
        for order in permutations(legs):
            yield [{name: leg} for name in order for leg in legs[name]]
