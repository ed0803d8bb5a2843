"""What is measured at a visit of the tests, and what an arm is commanded to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from cellapp.estimation.iso9283.norm import IsoCommands, IsoTest
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True)
class Place:
    """What is measured at a visit: its positions are evaluated together, over all cycles.

    ``poses`` are those of ``arms`` in turn; ``approach`` is the direction of a multi-directional test or of a force,
    ``speed`` the share of the profile's speed where the test is repeated at another one, else 0; ``load_kg`` the load
    where it is repeated with another one, ``force_n`` the force on the flange in a test of static compliance.
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
    """What one arm is commanded to with one kind of commands.

    Attributes
    ----------
    name : str
    commands : str
    position_M : mapping
        Position -> where its SMR should be [m].
    frame : mapping
        Position -> covariance (3, 3) of that [m^2].
    rotation_M : mapping
        Position -> how its probe should be turned (3, 3); empty where that is not known.
    q : mapping
        (position, the one before) -> joint positions (N,) [rad]: a model with play commands by the side of approach.
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
        """The place of a position of this arm alone."""
        return Place(test, self.commands, (self.name,), (pose,), approach, speed, load_kg)
