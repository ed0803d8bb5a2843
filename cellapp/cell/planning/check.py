"""A second check of a complete plan by the safety gate: every stop, every motion, the tracker's view of each SMR."""

from __future__ import annotations

from collections.abc import Iterator

from cellapp.cell.planning.planned_stops import Configuration, PlannedStops, orders, refused_route, routes
from cellapp.cell.planning.records import PlanCheckResult, PlanRefusal
from cellapp.cell.planning.stored_stops import read_planned_stops
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, refuse_motion, refuse_stop
from cellapp.cell.safety.hidden import why_hidden
from cellapp.ground.errors import InputError
from cellapp.ground.pace import with_eta
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore
from cellapp.robot.kinematics.transforms import Array

_PROGRESS_EVERY = 10
"""Stops between two progress reports."""


def check_plan_run(run: RunFile, listener: Listener = ignore, cancel: CancelToken | None = None) -> PlanCheckResult:
    """Check the plan of a run; nothing is written.

    Raises
    ------
    InputError
        If the run has no plan.
    Cancelled
    """
    required_plan(run)
    stops = read_planned_stops(run)
    refused = check_stops(run.profile, stops, listener, cancel)
    return PlanCheckResult(run=str(run.folder), stops=len(stops), ways=len(stops) + 1, refused=refused)


def check_stops(
    profile: Profile, stops: PlannedStops, listener: Listener = ignore, cancel: CancelToken | None = None
) -> tuple[PlanRefusal, ...]:
    """List what the gate or the tracker's view refuses of a plan, from home through all stops and home again.

    Raises
    ------
    InputError
        If the profile does not describe the cell.
    Cancelled
    """
    cancel, listener = cancel or CancelToken(), with_eta(listener)
    cell, homes, count = cell_bodies(profile), home_positions(profile), len(stops)
    refused: list[PlanRefusal] = []
    here: Configuration = homes
    for k in range(count):
        cancel.check()
        if k % _PROGRESS_EVERY == 0:
            listener(Progress("check", k, count))
        there = stops.targets(k)
        refused += _stop_refusals(cell, k, there)
        refused += _way_refusals(cell, stops, k, here, homes)
        here = there
    reason = refuse_motion(cell, here, homes)
    if reason:
        via_home = any(not refused_route(cell, here, route) for route in orders(homes))
        refused.append(PlanRefusal(configuration=None, before=count - 1, what="way", reason=reason, via_home=via_home))
    listener(Progress("check", count, count, "done"))
    return tuple(refused)


def check_each_stop(profile: Profile, stops: PlannedStops) -> tuple[PlanRefusal, ...]:
    """List what the gate or the tracker's view refuses of each stop and its last motion, whatever the order.

    Raises ``InputError`` if the profile does not describe the cell.
    """
    cell = cell_bodies(profile)
    refused: list[PlanRefusal] = []
    for k in range(len(stops)):
        refused += _stop_refusals(cell, k, stops.targets(k))
        begin = {**stops.targets(k), **stops.approach_starts(k)}
        reason = refuse_motion(cell, begin, begin) or refuse_motion(cell, begin, stops.targets(k))
        if reason and stops.approach_starts(k):
            text = f"its last motion: {reason}"
            refused.append(PlanRefusal(configuration=k, before=None, what="way", reason=text))
    return tuple(refused)


def required_plan(run: RunFile) -> dict[str, Array]:
    """Read the plan of a run, arm -> q (n, N) [rad]. Raise ``InputError`` if there is none."""
    plan = run.read_plan()
    if not plan or not len(next(iter(plan.values()))):
        raise InputError(f"{run.path}: the run has no plan (its readings were imported); make one with 'cellapp plan'")
    return plan


def _stop_refusals(cell: CellBodies, k: int, q: Configuration) -> Iterator[PlanRefusal]:
    before = k - 1 if k else None
    if reason := refuse_stop(cell, q):
        yield PlanRefusal(configuration=k, before=before, what="stop", reason=reason)
    if reason := why_hidden(cell, q):
        yield PlanRefusal(configuration=k, before=before, what="view", reason=reason)


def _way_refusals(
    cell: CellBodies, stops: PlannedStops, k: int, here: Configuration, homes: Configuration
) -> Iterator[PlanRefusal]:
    """Yield the refusal of the planned motion to a stop, with the detour that collection would take, if any."""
    planned, *others = routes(stops, k, as_planned=True)
    reason = refused_route(cell, here, planned)
    if not reason or refuse_stop(cell, stops.targets(k)):
        return
    before = k - 1 if k else None
    refusal = PlanRefusal(configuration=k, before=before, what="way", reason=reason)
    detour = next((route for route in others if not refused_route(cell, here, route)), None)
    if detour is not None:
        word = "straight" if len(detour[0]) == len(stops.q) else "one arm after the other"
        yield refusal.model_copy(update={"detour": word})
        return
    from_home = any(not refused_route(cell, homes, route) for route in routes(stops, k, as_planned=k == 0))
    via_home = from_home and any(not refused_route(cell, here, route) for route in orders(homes))
    yield refusal.model_copy(update={"via_home": via_home})
