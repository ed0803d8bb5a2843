"""Ways of one or more arms to commands: straight, one after the other, or via home; never where they are stranded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from cellapp.collection.motion import MotionRefused, Mover, Vector
from drivers.arms.protocol import ArmState

Targets = Mapping[str, Vector]
"""Arm -> joint positions (N,) [rad]."""
CommandFrom = Callable[[str, Vector], Vector]
"""The command (N,) of an arm whose last motion begins at joint positions (N,) [rad]: backlash depends on the side."""

_STEP_BACK_RAD = np.radians(1.0)
"""How far a joint steps back to come from a given side: well beyond any play, short enough to stay clear."""


@dataclass(frozen=True)
class Driver:
    """Drives arms to their commands. ``homes`` are the home positions of all arms."""

    mover: Mover
    homes: Targets

    def to(self, names: Sequence[str], command: CommandFrom) -> dict[str, ArmState]:
        """Drive arms to their commands; the others go home first. Returns the states of ``names`` at rest.

        Only ways are taken after which the arms can move home again.

        Raises
        ------
        MotionRefused
            If the gate accepts no way.
        CellStopped
            As ``Mover.move``.
        """
        q = self.mover.positions()
        away = [name for name in q if name not in names and np.any(q[name] != self.homes[name])]
        if away:
            self.mover.go_home(away)
        targets = {name: command(name, q[name]) for name in names}
        way, refusal = self._accepted(_ways({name: [targets[name]] for name in names}))
        if not way:
            self.mover.go_home(names)
            targets = {name: command(name, self.homes[name]) for name in names}
            way, refusal = self._accepted(_ways({name: [targets[name]] for name in names}))
        return self._along(way, refusal)

    def back_to(self, targets: Targets, sides: Mapping[str, Vector]) -> dict[str, ArmState]:
        """Drive arms to ``targets`` so that each joint comes from a side: ``sides`` (N,) are signs of its last motion.

        Every joint with a sign steps back first. Returns and raises as ``to``.
        """
        legs = {name: [q - _STEP_BACK_RAD * sides[name], q] for name, q in targets.items()}
        way, refusal = self._accepted(_ways(legs))
        return self._along(way, refusal)

    def _accepted(self, ways: Iterable[list[Targets]]) -> tuple[list[Targets], str]:
        """The first way that the gate accepts, followed by some way home; else none, and the first refusal."""
        first = ""
        for way in ways:
            names = dict.fromkeys(name for leg in way for name in leg)
            for order in permutations(names):
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


def _ways(legs: Mapping[str, Sequence[Vector]]) -> Iterator[list[Targets]]:
    """All arms at once, then one after the other in every order; ``legs`` are the positions of each arm in turn."""
    yield [dict(zip(legs, leg, strict=True)) for leg in zip(*legs.values(), strict=True)]
    if len(legs) > 1:
        for order in permutations(legs):
            yield [{name: leg} for name in order for leg in legs[name]]
