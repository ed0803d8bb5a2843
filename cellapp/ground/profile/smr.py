"""What is on a flange for the tracker to see: an SMR or a 6-D probe."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, StrictFloat, field_validator

from cellapp.ground.profile.grown import GrownSection
from drivers.quantities import Angle, ArmLength, Turn
from drivers.settings import Section

ArmPoint = tuple[ArmLength, ArmLength, ArmLength]


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
    about it within which the SMR returns the beam. With a ``probe`` its orientation is measured as well.
    """

    offset: ArmPoint | Literal["unknown"]
    normal: tuple[StrictFloat, StrictFloat, StrictFloat] = (0.0, 0.0, 1.0)
    acceptance: Annotated[Angle, Field(gt=0.0, le=math.pi)] = math.radians(30.0)
    probe: Probe | None = None
    later_keys = frozenset({"probe"})

    @field_validator("normal")
    @classmethod
    def _unit_vector(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if not 0.9 < math.hypot(*value) < 1.1:
            raise ValueError("normal must be a unit vector in the flange frame")
        return value
