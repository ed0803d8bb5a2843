"""Storage of a plan in its run, as ``PlannedStops``, and of its design.

The table ``plan`` holds the joint positions, the document of ``stop_conditions`` approach and dwell. The document
``planned_stops`` holds the rest: ``{"legs": {stop: [{arm: [q1, ...]}, ...]}, "block": [...], "repeat_of": {stop: stop},
"frozen": [stop, ...], "load": [...]}``, stops from 0, ``block`` and ``load`` for each stop; without loads, the
profile's payload. In runs without this document all motions are straight and all stops in one block. All three are
written in one transaction.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from cellapp.cell.planning.design_records import PlanDesignResult
from cellapp.cell.planning.planned_stops import Configuration, PlannedStops, straight_stops
from cellapp.cell.planning.stop_conditions import (
    STOP_CONDITIONS_RESULT,
    StopConditions,
    read_stop_conditions,
    reason_of,
    stop_conditions_json,
)
from cellapp.cell.run import RunFile
from cellapp.ground.errors import InputError
from cellapp.ground.results import Record
from cellapp.robot.kinematics.transforms import Array

PLANNED_STOPS_RESULT = "planned_stops"
PLAN_DESIGN_RESULT = "plan_design"
"""Names of the documents; they are part of the file format."""


class _Stored(Record):
    """The document ``planned_stops``."""

    legs: Mapping[int, tuple[Mapping[str, tuple[float, ...]], ...]] = {}
    block: tuple[int, ...]
    repeat_of: Mapping[int, int] = {}
    frozen: tuple[int, ...] = ()
    load: tuple[int, ...] = ()


def read_planned_stops(run: RunFile) -> PlannedStops:
    """Read the plan of a run; it has no stops if the run has no plan.

    Raises
    ------
    InputError
        If one of its documents is damaged.
    """
    stops = straight_stops(run.read_plan())
    for stop, arms in read_stop_conditions(run).items():
        for name, one in arms.items():
            if stop < len(stops) and name in stops.q:
                stops.dwell_s[name][stop] = one.dwell_s
                if one.via is not None:
                    stops.approach_from[name][stop] = one.via
    text = run.read_result(PLANNED_STOPS_RESULT)
    if text is None:
        return stops
    try:
        return _with_stored(stops, _Stored.model_validate_json(text), run.profile.loads)
    except (ValidationError, ValueError) as error:
        raise InputError(
            f"{run.path}: the document '{PLANNED_STOPS_RESULT}' with the ways of its plan is damaged"
            f" ({reason_of(error)}); restore the run from a copy, or plan a new one"
        ) from None


def write_planned_stops(
    run: RunFile,
    stops: PlannedStops,
    *,
    proposed: Collection[int] = (),
    design: PlanDesignResult | None = None,
) -> None:
    """Store a plan in place of the one before.

    ``proposed`` are the numbers of stops that discovery proposed. ``design`` describes the design of the plan; None
    keeps the stored one.

    Raises
    ------
    InputError
        If a stop that is already measured would change.
    """
    documents = {
        STOP_CONDITIONS_RESULT: stop_conditions_json(conditions_of(stops, proposed)),
        PLANNED_STOPS_RESULT: _Stored(
            legs={
                stop: tuple({name: tuple(q.tolist()) for name, q in leg.items()} for leg in legs)
                for stop, legs in enumerate(stops.legs)
                if legs
            },
            block=tuple(stops.block.tolist()),
            repeat_of={stop: source for stop, source in enumerate(stops.repeat_of.tolist()) if source >= 0},
            frozen=tuple(np.flatnonzero(stops.frozen).tolist()),
            load=tuple(stops.load.tolist()) if stops.load.any() else (),
        ).model_dump_json(exclude_defaults=True),
    }
    if design is not None:
        documents[PLAN_DESIGN_RESULT] = design.to_json()
    run.write_plan(stops.q, documents)


def read_plan_design(run: RunFile) -> PlanDesignResult | None:
    """Read the design of a run's plan; None if it was not designed. Raise ``InputError`` if it is damaged."""
    text = run.read_result(PLAN_DESIGN_RESULT)
    return None if text is None else PlanDesignResult.from_json(text, f"{run.path}: {PLAN_DESIGN_RESULT}")


def conditions_of(stops: PlannedStops, proposed: Collection[int] = ()) -> dict[int, dict[str, StopConditions]]:
    """Collect approach and dwell of each arm at each stop that has some, or that discovery ``proposed``."""
    found: dict[int, dict[str, StopConditions]] = {}
    for stop in range(len(stops)):
        starts = stops.approach_starts(stop)
        of_stop = {
            name: StopConditions(starts.get(name), float(rest[stop]), stop in proposed)
            for name, rest in stops.dwell_s.items()
        }
        if stop in proposed or starts or any(one.dwell_s > 0.0 for one in of_stop.values()):
            found[stop] = of_stop
    return found


def _with_stored(stops: PlannedStops, stored: _Stored, loads: int) -> PlannedStops:
    """Complete the stops by the document. Raise ``ValueError`` if it does not fit them.

    Stops that were appended without it are in the last block and have the last load.
    """
    n = len(stops)
    numbers = [*stored.legs, *stored.repeat_of, *stored.repeat_of.values(), *stored.frozen]
    if max(len(stored.block), len(stored.load)) > n or any(not 0 <= stop < n for stop in numbers):
        raise ValueError(f"it tells of more stops than the {n} that are planned")
    legs = [stored.legs.get(stop, ()) for stop in range(n)]
    if not all(0 <= load < loads for load in stored.load):
        raise ValueError(f"it tells of load {max(stored.load)}, the profile has 0 to {loads - 1}")
    frozen = np.zeros(n, dtype=np.bool_)
    frozen[list(stored.frozen)] = True
    return replace(
        stops,
        legs=tuple(tuple(_checked_leg(stops.q, leg, stop) for leg in of_stop) for stop, of_stop in enumerate(legs)),
        block=_continued(stored.block, n),
        repeat_of=np.array([stored.repeat_of.get(stop, -1) for stop in range(n)], dtype=np.intp),
        frozen=frozen,
        load=_continued(stored.load, n),
    )


def _continued(values: tuple[int, ...], n: int) -> NDArray[np.intp]:
    """Return the values (n,), the last one repeated for the remaining stops; zeros if there is none."""
    last = values[-1] if values else 0
    return np.array((*values, *(last,) * (n - len(values))), dtype=np.intp)


def _checked_leg(plan: Mapping[str, Array], leg: Mapping[str, tuple[float, ...]], stop: int) -> Configuration:
    for name, q in leg.items():
        if name not in plan:
            raise ValueError(f"stop {stop}: a leg moves the arm '{name}', which has no plan")
        joints = plan[name].shape[1]
        if len(q) != joints or not all(map(math.isfinite, q)):
            raise ValueError(f"stop {stop}: a leg of arm {name} must have {joints} finite joint positions")
    return {name: np.array(q, dtype=np.float64) for name, q in leg.items()}
