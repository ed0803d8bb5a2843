"""Random planning of stops: all SMRs are visible to the tracker, and all arms reach the stops without collision.

Planning of stops by the method that the profile names, for a new plan or after stops that are kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from cellapp.cell.planning.candidates import random_configurations
from cellapp.cell.planning.designed_plan import design_stops
from cellapp.cell.planning.information import even_conditions, information_model
from cellapp.cell.planning.planned_stops import PlannedStops, joined_after, straight_stops, write_planned_stops
from cellapp.cell.planning.records import PlanDesignResult
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import CellBodies, clear_stops, refuse_motion, visible_stops
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.robot.kinematics.transforms import Array

_TRIES_PER_STOP = 60
"""Pairs of configurations tried for one stop. The twin cell accepts 58 %; at 8 %, still 99 % of stops are found."""
_PROGRESS_EVERY = 10
"""Stops between two progress reports."""


def plan_stops(
    profile: Profile, job: JobToken = UNATTENDED, *, kept: PlannedStops | None = None, add: int | None = None
) -> dict[str, Array]:
    """Sample stops for all arms with the profile's seed, arm -> q (stops + reserve, N) [rad]; or ``add`` further ones.

    Configurations are uniform in joint space, restricted to those where the tracker sees the SMR and the arm is clear
    of the floor and of itself. Their order is random, so that drift in time is not confounded with joint positions. A
    pair of configurations becomes the next stop if both arms can move there at any relative speed. The first follows
    home, or those that are ``kept``; the last one has a motion to the home positions.

    Raises
    ------
    InputError
        If not enough stops can be reached.
    """
    cell, homes = cell_bodies(profile), home_positions(profile)
    wanted = profile.plan.stops + profile.plan.reserve if add is None else add
    # further stops differ from those that exist already
    here, more_seed = (homes, ()) if kept is None else (kept.targets(len(kept) - 1), (len(kept),))
    rng = np.random.default_rng([profile.seed, 0x9A7, *more_seed])
    picks = {name: random_configurations(cell, profile, name, rng) for name in cell.arms}
    stops: list[Mapping[str, Array]] = []
    for number in range(1, wanted + 1):
        job.check()
        if (number - 1) % _PROGRESS_EVERY == 0:
            job.tell("plan", number - 1, wanted)
        q, refusal = _next_stop(cell, picks, stops[-1] if stops else here, homes if number == wanted else None)
        if q is None:
            raise InputError(
                f"plan: stop {number} of {wanted} not found in {_TRIES_PER_STOP} tries; the last was refused:"
                f" {refusal}. Ask for fewer stops, a smaller plan.clearance, or move bases or tracker"
            )
        stops.append(q)
    job.tell("plan", wanted, wanted, "done")
    return {name: np.array([stop[name] for stop in stops]) for name in cell.arms}


def sample_stops(
    cell: CellBodies, profile: Profile, count: int, rng: np.random.Generator, job: JobToken = UNATTENDED
) -> dict[str, Array]:
    """Sample stops at which all arms are clear and visible, arm -> q (count, N) [rad]; motions are not checked.

    Raises
    ------
    InputError
        If this number of stops is not found.
    """
    picks = {name: random_configurations(cell, profile, name, rng) for name in cell.arms}
    found = {name: np.empty((0, arm.geometry.joints)) for name, arm in cell.arms.items()}
    for _ in range(_TRIES_PER_STOP):
        job.check()
        pairs = [{name: next(configurations) for name, configurations in picks.items()} for _ in range(count)]
        q = {name: np.array([pair[name] for pair in pairs]) for name in picks}
        admitted = visible_stops(cell, q)
        admitted[admitted] = clear_stops(cell, {name: rows[admitted] for name, rows in q.items()})
        found = {name: np.concatenate([found[name], q[name][admitted]])[:count] for name in q}
        number = len(next(iter(found.values())))
        if number == count:
            return found
    raise InputError(
        f"plan: only {number} of {counted(count, 'stop was', 'stops were')} found at which all arms are visible and"
        " keep their clearance; ask for a smaller plan.clearance, or move bases or tracker"
    )


def _next_stop(
    cell: CellBodies, picks: Mapping[str, Iterator[Array]], here: Mapping[str, Array], homes: Mapping[str, Array] | None
) -> tuple[Mapping[str, Array] | None, str]:
    """Sample a stop reachable from ``here``, from which ``homes``, if given, are; None with the last refusal."""
    refusal = ""
    for _ in range(_TRIES_PER_STOP):
        q = {name: next(configurations) for name, configurations in picks.items()}
        if not visible_stops(cell, {name: one[None] for name, one in q.items()})[0]:
            refusal = "an arm or what it carries hides the other's SMR from the tracker"
            continue
        refusal = refuse_motion(cell, here, q)
        if not refusal and homes is not None:
            refusal = refuse_motion(cell, q, homes)
        if not refusal:
            return q, ""
    return None, refusal


def plan_run(run: RunFile, job: JobToken = UNATTENDED) -> PlannedStops:
    """Plan the stops of a run, and store them with the description of their design.

    Raises
    ------
    InputError
        If not enough stops can be reached.
    Cancelled
    """
    stops, design = make_stops(run.profile, job)
    write_planned_stops(run, stops, design=design)
    return stops


def make_stops(
    profile: Profile, job: JobToken = UNATTENDED, *, kept: PlannedStops | None = None, add: int | None = None
) -> tuple[PlannedStops, PlanDesignResult | None]:
    """Plan stops by ``plan.method``; return them with the description of their design, None for random ones.

    Parameters
    ----------
    profile : Profile
    job
        Progress and cancelling.
    kept : PlannedStops, optional
        Stops that are in the plan already; they stay in their order at its beginning, and their information counts.
    add : int, optional
        Number of further stops; None: up to the number that the profile asks for, reserves included.

    Raises
    ------
    InputError
        If there is nothing to add, or not enough stops can be reached.
    Cancelled
    """
    wanted, before = profile.plan.stops + profile.plan.reserve, 0 if kept is None else len(kept)
    if add is None and before >= wanted:
        raise InputError(
            f"plan: {counted(before, 'stop is', 'stops are')} kept, and plan.stops and plan.reserve ask for {wanted}:"
            " nothing is left to design; ask for more stops, or keep fewer"
        )
    kept, count = kept if before else None, wanted - before if add is None else add
    if profile.plan.method == "random":
        stops = straight_stops(plan_stops(profile, job, kept=kept, add=count))
        return _with_loads(profile, stops if kept is None else joined_after(kept, stops), before), None
    stops, design = design_stops(profile, count, job, kept)
    return _with_loads(profile, stops, before), design


_SHOWN = 100
"""Configurations of each arm at which an effect must show that a plan is asked to show."""


def require_plannable(profile: Profile) -> None:
    """Raise ``InputError`` for what no plan of this cell can have: more loads than stops, effects, parameters."""
    _require_stops(profile.plan.stops, profile.loads)
    if profile.plan.method == "random":
        return
    rng = np.random.default_rng(profile.seed)
    limits = {name: np.array(arm.joint_limits) for name, arm in profile.arms.items()}
    picks = {name: rng.uniform(ends[:, 0], ends[:, 1], (_SHOWN, len(ends))) for name, ends in limits.items()}
    for name, q in picks.items():
        information_model(profile, name, q, even_conditions(profile, name, q, picks, rng), potential=False)


def _require_stops(stops: int, loads: int) -> None:
    if stops < loads:
        raise InputError(
            f"plan: {counted(stops, 'stop is', 'stops are')} too few for {loads} loads; ask for more stops"
        )


def _with_loads(profile: Profile, stops: PlannedStops, before: int) -> PlannedStops:
    """Assign the loads of the profile in turn, to equally many stops each; those ``before`` keep their loads.

    Blocks are in random order and each covers the workspace, so every load covers it too. Reserves get the last load.
    """
    first = int(stops.load[before - 1]) if before else 0
    reserves = 0 if before else len(profile.plan.reserves(len(stops)))
    remaining, n = profile.loads - first, len(stops) - before - reserves
    _require_stops(n, remaining)
    load = first + np.minimum(np.arange(len(stops) - before) * remaining // n, remaining - 1)
    return replace(stops, load=np.concatenate([stops.load[:before], load]))
