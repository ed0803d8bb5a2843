"""Places that are measured in the tests, and the commands of an arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from cellapp.estimation.iso9283.norm import IsoCommands, IsoTest
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True)
class Place:
    """Key of what is measured at a visit; the positions of one place are evaluated together over all cycles.

    ``poses`` are those of ``arms`` in turn. ``approach`` is the direction of a multi-directional test or of a force.
    ``speed`` is the share of the profile's speed if the test is repeated at another speed, else 0. ``load_kg`` is the
    load if it is repeated with another load. ``force_n`` is the force on the flange in a static compliance test.
    """

    test: IsoTest
    commands: IsoCommands
    arms: tuple[str, ...]
    poses: tuple[str, ...]
    approach: str = ""
    speed: float = 0.0
    load_kg: float | None = None
    force_n: float | None = None

    def __str__(self) -> str:
        where = "+".join(self.poses) + (f" along {self.approach}" if self.approach else "")
        where += f", {self.speed:.0%} of the speed" if self.speed else ""
        where += "" if self.load_kg is None else f", with {self.load_kg:g} kg"
        where += "" if self.force_n is None else f", {self.force_n:g} N"
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

    def place(
        self, test: IsoTest, pose: str, approach: str = "", speed: float = 0.0, load_kg: float | None = None
    ) -> Place:
        """Return the place of a pose of this arm alone."""
        return Place(test, self.commands, (self.name,), (pose,), approach, speed, load_kg)
