"""Results of ``plan``, and the planned stops as ``show DIR plan`` gives them."""

from __future__ import annotations

from collections.abc import Mapping

from cellapp.cell.planning.records import PlanDesignResult, PlannedTime
from cellapp.ground.results import Record, Result


class SweepCount(Record):
    """Planned sweeps of one arm: number, how long they last together; beside ``swinging`` of them the other arm
    swings."""

    n: int
    seconds: float
    swinging: int | None = None
    omitted_when_none = frozenset({"swinging"})


class PlannedLoad(Record):
    """Stops (numbers from 1) of a plan that are measured with one load, and what each arm carries then [kg]."""

    first: int
    last: int
    payload_kg: Mapping[str, float]


class PlanResult(Result, schema="cellapp-plan"):
    """``plan``: number of planned stops of each arm, and of further ones in reserve.

    ``design`` is what is known of designed stops, ``time`` how long collecting them takes; ``sweeps`` are
    those of each arm, ``loads`` the loads one after the other where there are several.
    """

    run: str
    stops: Mapping[str, int]
    reserves: int = 0
    design: PlanDesignResult | None = None
    time: PlannedTime | None = None
    sweeps: Mapping[str, SweepCount] | None = None
    loads: tuple[PlannedLoad, ...] | None = None
    notes: tuple[str, ...] = ()
    omitted_when_none = frozenset({"design", "time", "sweeps", "loads"})


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
