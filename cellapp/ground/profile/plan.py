"""The profile's section ``plan``: number of stops, what keeps them safe, what they shall tell."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from drivers.quantities import Angle, CellLength, Time, Turn
from drivers.settings import Section

CANDIDATES_PER_STOP = 50
MOST_CANDIDATES = 20_000


class Plan(Section):
    """Number of stops and how they are chosen. ``floor`` is the height in C below which no body may reach.

    ``method``: ``designed`` chooses the stops that tell most about geometry and effects, with planned approach, dwell
    and order; ``random`` draws them, with straight ways.
    """

    stops: Annotated[int, Field(strict=True, ge=1, le=100_000)] = 400
    clearance: Annotated[CellLength, Field(ge=0.0)] = 0.05
    floor: CellLength = 0.0
    ceiling: CellLength | None = None
    """Height in C above which no body may reach; None: no ceiling."""
    reserve: Annotated[int, Field(strict=True, ge=0, le=10_000)] = 0
    """Further stops, planned after the others; each replaces one that could not be measured."""
    ranges: tuple[tuple[Turn, Turn], ...] | None = None
    """Joint ranges to draw from, for all arms; None: the limits of each arm, at most one turn."""
    method: Literal["designed", "random"] = "designed"
    candidates: Annotated[int, Field(strict=True, ge=100, le=1_000_000)] | None = None
    """Configurations of each arm from which a design is chosen; None: 50 a stop, at most 20 000."""
    effects: tuple[str, ...] | None = None
    """Slugs of the effects whose coefficients the stops shall tell; None: all that the program knows."""
    incidence: Annotated[Angle, Field(gt=0.0, le=math.pi / 2.0)] = math.radians(20.0)
    """Angle between beam and the SMR's viewing direction up to which the tracker has its full accuracy."""
    steps: tuple[Annotated[Angle, Field(gt=0.0, le=math.pi / 2.0)], ...] = (math.radians(2.0), math.radians(8.0))
    """Sizes of each joint's last motion before a stop; its side is planned too. Empty: straight ways."""
    dwell: Annotated[tuple[Annotated[Time, Field(ge=0.0, le=600.0)], ...], Field(min_length=1)] = (0.0,)
    """Rests before a measurement that are varied, beside the settling that the arm needs."""
    repeats: Annotated[int, Field(strict=True, ge=0, le=10_000)] = 10
    """Of the stops, those that visit an earlier configuration again, from the other side of every joint."""
    blocks: Annotated[int, Field(strict=True, ge=1, le=1000)] | None = None
    """Parts of the run in random order, so that drift in time is not confounded with posture; None: by the stops."""
    other_arm: Literal["resting", "swinging"] = "resting"
    """What the other arm does while one sweeps; swinging, it is recorded beside and not measured."""
    largest_gap: Annotated[Angle, Field(gt=0.0, le=2.0 * math.pi)] | None = None
    """Largest part of any joint's travelled range without a stop; None: as the number of stops allows."""

    @property
    def pool_size(self) -> int:
        """Number of candidate configurations of each arm."""
        return self.candidates or min(CANDIDATES_PER_STOP * (self.stops + self.reserve), MOST_CANDIDATES)

    def reserves(self, total: int) -> range:
        """Return the numbers of the reserve stops in a plan of ``total`` stops: they follow the asked ones."""
        return range(min(self.stops, total), min(self.stops + self.reserve, total))
