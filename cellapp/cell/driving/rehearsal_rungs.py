"""Rungs of a rehearsal, the safest first; without heavy imports, because requests name them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

RungName = Literal["simulation", "one-arm", "ten-stops", "both-arms"]


@dataclass(frozen=True)
class Rung:
    """Step of the rehearsal: number of stops (None: all), fraction of the profile's speed, one arm or all."""

    stops: int | None
    share: float
    one_arm: bool
    simulation: bool
    words: str


RUNGS: Mapping[RungName, Rung] = {
    "simulation": Rung(None, 1.0, False, True, "the whole plan on controllers in simulation mode"),
    "one-arm": Rung(1, 0.05, True, False, "one stop of one arm at 5 % speed"),
    "ten-stops": Rung(10, 0.05, True, False, "ten stops of one arm at 5 % speed"),
    "both-arms": Rung(10, 0.05, False, False, "ten stops of all arms at 5 % speed"),
}
"""Rungs in the order in which they are taken."""
