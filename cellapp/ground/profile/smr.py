"""What is on a flange for the tracker to see: one SMR, several in nests, or a 6-D probe."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, StrictFloat, StringConstraints, field_validator, model_validator

from cellapp.ground.profile.grown import GrownSection
from drivers.quantities import Angle, ArmLength, Length, Turn
from drivers.settings import Section

ArmPoint = tuple[ArmLength, ArmLength, ArmLength]
NestName = Annotated[str, StringConstraints(pattern=r"^[0-9A-Za-z_-]{1,20}$")]


class Nest(Section):
    """A further SMR on a flange; ``offset: unknown`` identifies it from the data."""

    offset: ArmPoint | Literal["unknown"] = "unknown"


class NestDistance(Section):
    """A known distance between two SMRs on a flange."""

    between: tuple[NestName, NestName]
    distance: Annotated[Length, Field(gt=0.0)]
    sigma: Annotated[Length, Field(gt=0.0)] = 10e-6


class Probe(Section):
    """A 6-D probe, as a T-Mac, whose origin the SMR is.

    ``rpy`` is the rotation of its frame in the flange frame, which is identified from the data either way; a
    simulated cell needs it. ``sigma`` is the standard uncertainty of a measured orientation about each axis.
    """

    rpy: tuple[Turn, Turn, Turn] | Literal["unknown"] = "unknown"
    sigma: Annotated[Angle, Field(gt=0.0, le=0.1)] = 40e-6


class Smr(GrownSection):
    """The retroreflector on a flange.

    ``offset: unknown`` identifies it from the data. ``normal`` is the viewing direction, ``acceptance`` the half-angle
    about it within which the SMR returns the beam. Where there are several, ``name`` is that of this one, and
    ``nests`` are the others, which look the same way. With a ``probe`` its orientation is measured as well.
    """

    offset: ArmPoint | Literal["unknown"]
    normal: tuple[StrictFloat, StrictFloat, StrictFloat] = (0.0, 0.0, 1.0)
    acceptance: Annotated[Angle, Field(gt=0.0, le=math.pi)] = math.radians(30.0)
    name: NestName = "1"
    nests: dict[NestName, Nest] = Field(default_factory=dict)
    distances: tuple[NestDistance, ...] = ()
    probe: Probe | None = None
    later_keys = frozenset({"name", "nests", "distances", "probe"})

    @model_validator(mode="after")
    def _nests_are_told_apart(self) -> Self:
        if self.name in self.nests:
            raise ValueError(f"nests: '{self.name}' is the name of the SMR itself; give each nest a name of its own")
        if self.nests and self.probe is not None:
            raise ValueError("probe: a flange has a 6-D probe or several nests, not both")
        for index, one in enumerate(self.distances):
            for name in one.between:
                if name not in self.names:
                    raise ValueError(
                        f"distances[{index}]: no nest is called '{name}'; there are {', '.join(self.names)}"
                    )
            if one.between[0] == one.between[1]:
                raise ValueError(f"distances[{index}]: expected two different nests, got '{one.between[0]}' twice")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all SMRs on the flange, this one first."""
        return (self.name, *self.nests)

    @property
    def tells_orientation(self) -> bool:
        """Whether what is on the flange tells its orientation: a 6-D probe, or three nests and more."""
        return self.probe is not None or len(self.names) >= 3

    @field_validator("normal")
    @classmethod
    def _unit_vector(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if not 0.9 < math.hypot(*value) < 1.1:
            raise ValueError("normal must be a unit vector in the flange frame")
        return value
