"""Stops that discovery proposed, appended to the plan of a run that this program drives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.discovery.propose import ProposedStop
from cellapp.planning.stop_conditions import read_stop_conditions, write_stop_conditions
from cellapp.run import RunFile


def append_proposed_stops(run: RunFile, stops: Sequence[ProposedStop]) -> int:
    """Append stops to the plan in place of earlier proposals that were not measured. Returns the first one's number."""
    plan, done, conditions = run.read_plan(), run.stops_done(), read_stop_conditions(run)
    first = len(next(iter(plan.values())))
    while first - 1 in conditions and first - 1 not in done:
        first -= 1
    run.write_plan(
        {name: np.concatenate([rows[:first], [stop.q[name] for stop in stops]]) for name, rows in plan.items()}
    )
    kept = {stop: arms for stop, arms in conditions.items() if stop < first}
    write_stop_conditions(run, {**kept, **{first + k: stop.conditions for k, stop in enumerate(stops)}})
    return first


def why_not_driven(run: RunFile) -> str:
    """Why this program cannot drive further stops of a run; empty if it can."""
    missing = [f"arms.{name}" for name, arm in run.profile.arms.items() if not arm.driver.has_device]
    missing += [] if run.profile.tracker.driver.has_device else ["tracker"]
    if missing:
        return f"the driver of {missing[0]} is 'none'"
    return "" if run.read_plan() else "the run has no plan (it was imported)"
