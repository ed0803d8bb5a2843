"""The safety gate over a whole plan once more: every stop, every way between stops, the tracker's view of each SMR."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import permutations

from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.planning.plan import all_smrs_visible
from cellapp.planning.stop_conditions import StopConditions, read_stop_conditions
from cellapp.progress import CancelToken, Listener, Progress, ignore, with_eta
from cellapp.results import PlanCheckResult, PlanRefusal
from cellapp.run import RunFile
from cellapp.safety.cell_bodies import cell_bodies, home_positions
from cellapp.safety.gate import CellBodies, refuse_motion, refuse_stop

Configuration = Mapping[str, Array]
"""Arm -> joint positions (N,) [rad]."""

_PROGRESS_EVERY = 10
"""Stops between two progress reports."""


def check_plan_run(run: RunFile, listener: Listener = ignore, cancel: CancelToken | None = None) -> PlanCheckResult:
    """Check the plan of a run. It only reads.

    Raises
    ------
    InputError
        If the run has no plan.
    Cancelled
    """
    cancel, listener = cancel or CancelToken(), with_eta(listener)
    plan = required_plan(run)
    cell, homes, conditions = cell_bodies(run.profile), home_positions(run.profile), read_stop_conditions(run)
    count = len(next(iter(plan.values())))
    stops = [{name: q[k] for name, q in plan.items()} for k in range(count)]
    refused: list[PlanRefusal] = []
    for k, there in enumerate(stops):
        cancel.check()
        if k % _PROGRESS_EVERY == 0:
            listener(Progress("check", k, count))
        here = stops[k - 1] if k else homes
        refused += _stop_refusals(cell, k, there)
        refused += _way_refusals(cell, k, here, there, homes, conditions.get(k))
    reason = refuse_motion(cell, stops[-1], homes)
    if reason:
        via_home = bool(_one_by_one(cell, stops[-1], homes))
        refused.append(PlanRefusal(configuration=None, before=count - 1, what="way", reason=reason, via_home=via_home))
    listener(Progress("check", count, count, "done"))
    return PlanCheckResult(run=str(run.folder), stops=count, ways=count + 1, refused=tuple(refused))


def required_plan(run: RunFile) -> dict[str, Array]:
    """The plan of a run, arm -> q (n, N) [rad]. Raises ``InputError`` without one."""
    plan = run.read_plan()
    if not plan or not len(next(iter(plan.values()))):
        raise InputError(f"{run.path}: the run has no plan (its readings were imported); make one with 'cellapp plan'")
    return plan


def _stop_refusals(cell: CellBodies, k: int, q: Configuration) -> Iterator[PlanRefusal]:
    before = k - 1 if k else None
    if reason := refuse_stop(cell, q):
        yield PlanRefusal(configuration=k, before=before, what="stop", reason=reason)
    if not all_smrs_visible(cell, q):
        reason = "the tracker does not see every SMR: turned away, out of its range, or hidden by an arm or an obstacle"
        yield PlanRefusal(configuration=k, before=before, what="view", reason=reason)


def _way_refusals(
    cell: CellBodies,
    k: int,
    here: Configuration,
    there: Configuration,
    homes: Configuration,
    conditions: Mapping[str, StopConditions] | None,
) -> Iterator[PlanRefusal]:
    """The refusal of the way to a stop, as collection would go: straight, or through the start of its approach.

    Only to a proposed stop (with ``conditions``) may the arms go one after the other.
    """
    vias = {name: one.via for name, one in (conditions or {}).items() if one.via is not None}
    begin = {**there, **vias}
    last = refuse_motion(cell, begin, there) if vias else ""
    reason = _leg(cell, here, begin, proposed=conditions is not None) or last
    if reason and not refuse_stop(cell, there):
        from_home = not last and not _leg(cell, homes, begin, proposed=conditions is not None)
        via_home = from_home and bool(_one_by_one(cell, here, homes))
        before = k - 1 if k else None
        yield PlanRefusal(configuration=k, before=before, what="way", reason=reason, via_home=via_home)


def _leg(cell: CellBodies, here: Configuration, there: Configuration, *, proposed: bool) -> str:
    """Reason why the arms cannot go at once, nor, to a ``proposed`` stop, one after the other; empty if they can."""
    reason = refuse_motion(cell, here, there)
    return "" if not reason or (proposed and _one_by_one(cell, here, there)) else reason


def _one_by_one(cell: CellBodies, here: Configuration, there: Configuration) -> tuple[str, ...]:
    """An order in which the arms may move one after the other; empty if there is none."""
    for order in permutations(here):
        now = dict(here)
        for name in order:
            after = {**now, name: there[name]}
            if refuse_motion(cell, now, after):
                break
            now = after
        else:
            return order
    return ()
