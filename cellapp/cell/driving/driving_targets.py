"""How one or more arms are driven to commands: straight, one after the other, or via home, never into a dead end."""

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
"""Arm -> signs (N,) of each joint's last motion to ask for, 0 where it does not matter; none asked for if left out."""
CommandFrom = Callable[[str, Vector], Vector]
"""The command (N,) of an arm that stands at joint positions (N,) [rad] before: backlash depends on the side."""

_STEPS_BACK_RAD = (np.radians(1.0), np.radians(0.25))
"""How far a joint steps back to come from a given side: well beyond any play, short enough to stay clear. The second
one is for arms that are near to something."""


@dataclass(frozen=True)
class Driver:
    """Drives arms to their commands. ``homes`` are the home positions of all arms."""

    mover: Mover
    homes: Targets

    def to(self, names: Sequence[str], command: CommandFrom, sides: Sides) -> dict[str, ArmState]:
        """Drive arms to their commands, from the given sides; the others go home first. Returns the states of ``names``
        at rest.

        Only ways are taken after which the arms can move home again.

        Raises
        ------
        MotionRefused
            If the gate accepts no way.
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
        """Drive arms that are near to ``targets``, from the given sides. Returns and raises as ``to``."""
        way, refusal = self._accepted(targets, sides)
        if not way:
            way, _ = self._accepted(targets, sides, _STEPS_BACK_RAD[1])
        return self._along(way, refusal)

    def _accepted(
        self, targets: Targets, sides: Sides, step_rad: float = _STEPS_BACK_RAD[0]
    ) -> tuple[list[Targets], str]:
        """The first way that the gate accepts, followed by some way home; else none, and the first refusal."""
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
    """Where an arm (N,) [rad] steps back to, so that each joint with a sign comes to ``q`` (N,) from that side."""
    return q if sides is None else np.asarray(q - step_rad * sides)


def arrival(q: Vector, start: Vector, sides: Vector | None) -> Vector:
    """From where (N,) [rad] each joint comes to ``q`` (N,) if the arm stands at ``start`` (N,) before."""
    return start if sides is None else np.where(sides != 0, before_side(q, sides), start)


def _ways(legs: Mapping[str, Sequence[Vector]]) -> Iterator[list[Targets]]:
    """All arms at once, then one after the other in every order; ``legs`` are the positions of each arm in turn."""
    yield [dict(zip(legs, leg, strict=True)) for leg in zip(*legs.values(), strict=True)]
    if len(legs) > 1:
        for order in permutations(legs):
            yield [{name: leg} for name in order for leg in legs[name]]
