"""Places that are measured in the tests, and the commands of an arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from cellapp.estimation.iso9283.norm import IsoCommands, IsoTest
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True)
class Place:
    """Key of what is measured at a visit; the positions of one place are evaluated together over all cycles.

    ``poses`` are those of ``arms`` in turn. ``approach`` is the direction of a multi-directional test.
    ``speed`` is the share of the profile's speed if the test is repeated at another speed, else 0.
    """

    test: IsoTest
    commands: IsoCommands
    arms: tuple[str, ...]
    poses: tuple[str, ...]
    approach: str = ""
    speed: float = 0.0

    def __str__(self) -> str:
        where = "+".join(self.poses) + (f" along {self.approach}" if self.approach else "")
        where += f", {self.speed:.0%} of the speed" if self.speed else ""
        return f"{self.test} of {' and '.join(self.arms)}, {self.commands} commands, {where}"


@dataclass(frozen=True, eq=False)
class ArmProgramme:
    """Commands of one arm with one kind of commands.

    Attributes
    ----------
    name : str
    commands : str
    position_M : mapping
        Name of a pose -> commanded SMR position (3,) [m].
    frame : mapping
        Name of a pose -> covariance (3, 3) of that position [m^2].
    rotation_M : mapping
        Name of a pose -> commanded orientation (3, 3) of its probe; empty if unknown.
    q : mapping
        (pose, previous pose) -> joint positions (N,) [rad]: with backlash in the model they depend on the approach.
    """

    name: str
    commands: IsoCommands
    position_M: Mapping[str, Array]
    frame: Mapping[str, Array]
    q: Mapping[tuple[str, str], Array]
    rotation_M: Mapping[str, Array] = field(default_factory=dict)

    def place(self, test: IsoTest, pose: str, approach: str = "", speed: float = 0.0) -> Place:
        """Return the place of a pose of this arm alone."""
        return Place(test, self.commands, (self.name,), (pose,), approach, speed)
