"""Stops that discovery proposed, appended to the plan of a run that this program drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellapp.cell.planning.planned_stops import PlannedStops, joined, straight_stops
from cellapp.cell.planning.proposal.propose import ProposedStop
from cellapp.cell.planning.stop_conditions import StopConditions, proposed_stops, read_stop_conditions
from cellapp.cell.planning.stored_stops import read_planned_stops, write_planned_stops
from cellapp.cell.run import RunFile


def append_proposed_stops(run: RunFile, stops: Sequence[ProposedStop]) -> int:
    """Append stops to the plan in place of earlier proposals that were not measured; return the first one's number."""
    plan, done, proposed = read_planned_stops(run), run.stops_done(), proposed_stops(read_stop_conditions(run))
    first = len(plan)
    while first - 1 in proposed and first - 1 not in done:
        first -= 1
    further = range(first, first + len(stops))
    whole = joined(plan.take(range(first)), _planned(stops))
    block = np.where(np.arange(len(whole)) < first, whole.block, whole.block[:first].max(initial=-1) + 1)
    load = np.where(np.arange(len(whole)) < first, whole.load, whole.load[:first].max(initial=0))  # the last load
    earlier = {stop for stop in proposed if stop < first}
    write_planned_stops(run, replace(whole, block=block, load=load), proposed={*earlier, *further})
    return first


def why_not_driven(run: RunFile) -> str:
    """Say why this program cannot drive further stops of a run; empty if it can."""
    missing = [f"arms.{name}" for name, arm in run.profile.arms.items() if not arm.driver.has_device]
    missing += [] if run.profile.tracker.driver.has_device else ["tracker"]
    if missing:
        return f"the driver of {missing[0]} is 'none'"
    return "" if run.read_plan() else "the run has no plan (it was imported)"


def _planned(stops: Sequence[ProposedStop]) -> PlannedStops:
    """Convert the proposed stops to planned ones with straight motions."""
    planned = straight_stops({name: np.array([stop.q[name] for stop in stops]) for name in stops[0].q})
    for k, stop in enumerate(stops):
        for name in planned.q:
            one = stop.conditions.get(name, StopConditions())
            planned.dwell_s[name][k] = one.dwell_s
            if one.via is not None:
                planned.approach_from[name][k] = one.via
    return planned
