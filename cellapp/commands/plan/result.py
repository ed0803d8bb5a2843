"""Planned stops as ``show DIR plan`` gives them."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.cell.driving.records import PlannedLoad, SweepCount
from cellapp.cell.planning.records import PlanDesignResult
from cellapp.ground.results import Record, Result


class PlannedStop(Record):
    """One planned stop: joint positions of every arm [rad], whether it was measured."""

    configuration: int
    measured: bool
    q: Mapping[str, tuple[float, ...]]


class StopsResult(Result, schema="cellapp-stops"):
    """``show DIR plan``: every planned stop, what is known of their design, the sweeps, and several loads."""

    run: str
    stops: tuple[PlannedStop, ...]
    design: PlanDesignResult | None = None
    sweeps: Mapping[str, SweepCount] | None = None
    loads: tuple[PlannedLoad, ...] | None = None
    omitted_when_none = frozenset({"design", "sweeps", "loads"})
