"""Records of what a run holds: what its order of measurement gave, readings that are missing, references."""

from __future__ import annotations

from typing import Literal

from cellapp.ground.results import Record


class MissingReading(Record):
    """An arm has no reading at a planned stop, and why."""

    stop: int
    arm: str
    kind: Literal["not measured", "left out", "not tried"]
    reason: str


class ReferenceDrift(Record):
    """A reference measurement: distance from the first one of the same name, after a number of stops."""

    name: str
    stops_done: int
    drift_mm: float


class ArmOrder(Record):
    """What an import in order of measurement derived for one arm.

    Attributes
    ----------
    by : str
        What gave the order: the rows, the column ``sequence``, or the times.
    approach, step : int
        Approach signs and steps of single joints that were derived from the reading before.
    contradicted : int
        Given approach signs that contradict the motion from the reading before; the steps there are unknown.
    """

    by: Literal["rows", "sequence", "time"]
    approach: int
    step: int
    contradicted: int = 0
