"""Planning of stops by the method that the profile names, for a new plan or after stops that are kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellapp.cell.planning.balance import correlations, travel_time
from cellapp.cell.planning.design_records import ArmDesign, PlanDesignResult
from cellapp.cell.planning.designed import DesignedStops, design_stops, of_each_arm
from cellapp.cell.planning.plan import further_stops
from cellapp.cell.planning.plan_quality import arm_design
from cellapp.cell.planning.planned_stops import PlannedStops, joined_after, straight_stops, write_planned_stops
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore


def plan_run(run: RunFile, listener: Listener = ignore, cancel: CancelToken | None = None) -> PlannedStops:
    """Plan the stops of a run, and store them with the description of their design.

    Raises
    ------
    InputError
        If not enough stops can be reached.
    Cancelled
    """
    stops, design = make_stops(run.profile, listener, cancel)
    write_planned_stops(run, stops, design=design)
    return stops


def make_stops(
    profile: Profile,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    *,
    kept: PlannedStops | None = None,
    add: int | None = None,
) -> tuple[PlannedStops, PlanDesignResult | None]:
    """Plan stops by ``plan.method``; return them with the description of their design, None for random ones.

    Parameters
    ----------
    profile : Profile
    listener, cancel
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
    wanted = profile.plan.stops + profile.plan.reserve
    if kept is not None and add is None and len(kept) >= wanted:
        raise InputError(
            f"plan: {counted(len(kept), 'stop is', 'stops are')} kept, and plan.stops and plan.reserve ask for"
            f" {wanted}: nothing is left to design; ask for more stops, or keep fewer"
        )
    count = wanted - (0 if kept is None else len(kept)) if add is None else add
    if profile.plan.method == "random":
        return _with_loads(profile, _random(profile, count, listener, cancel, kept), kept), None
    designed = design_stops(profile, count, listener, cancel, kept)
    return _with_loads(profile, designed.stops, kept), design_result(profile, designed, listener, cancel)


def _with_loads(profile: Profile, stops: PlannedStops, kept: PlannedStops | None) -> PlannedStops:
    """Assign the loads of the profile in turn, to equally many stops each; kept stops keep their loads.

    Blocks are in random order and each covers the workspace, so every load covers it too. Reserves get the last load.
    """
    before = 0 if kept is None else len(kept)
    first = int(stops.load[before - 1]) if before else 0
    reserves = 0 if before else len(profile.plan.reserves(len(stops)))
    left, n = profile.loads - first, len(stops) - before - reserves
    if n < left:
        raise InputError(f"plan: {counted(n, 'stop is', 'stops are')} too few for {left} loads; ask for more stops")
    load = first + np.minimum(np.arange(len(stops) - before) * left // n, left - 1)
    return replace(stops, load=np.concatenate([stops.load[:before], load]))


def _random(
    profile: Profile, count: int, listener: Listener, cancel: CancelToken | None, kept: PlannedStops | None
) -> PlannedStops:
    """Draw random stops with straight motions, and append them to those that are kept."""
    if kept is None or not len(kept):
        return straight_stops(further_stops(profile, home_positions(profile), count, (), listener, cancel))
    here = kept.targets(len(kept) - 1)
    return joined_after(kept, straight_stops(further_stops(profile, here, count, (len(kept),), listener, cancel)))


# -- Description of a designed plan: what it tells against random stops, correlations of its factors, its time --------


_SEED = 0xDE52


def design_result(
    profile: Profile,
    designed: DesignedStops,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> PlanDesignResult:
    """Compare the asked stops of a plan with random ones of the same number; reserves do not count.

    Raises ``Cancelled`` on request.
    """
    stops, pools = designed.stops, designed.pools
    rng = np.random.default_rng([profile.seed, _SEED])
    reserves = profile.plan.reserves(len(stops))
    asked = stops.take([stop for stop in range(len(stops)) if stop not in reserves])

    def compare(name: str, own_rng: np.random.Generator) -> ArmDesign:
        return arm_design(profile, pools[name], name, asked.q, own_rng, cancel=cancel)

    listener(Progress("compare", 0, len(pools), "with random stops"))
    arms = of_each_arm(compare, pools, rng)
    listener(Progress("compare", len(pools), len(pools), "done"))
    return PlanDesignResult(
        arms=arms,
        correlations=correlations(profile, cell_bodies(profile), asked),
        travel=travel_time(profile, asked, designed.finder, rng),
        detours=sum(bool(legs) for legs in asked.legs),
        blocks=len(np.unique(asked.block)),
        repeats=int(np.sum(asked.repeat_of >= 0)),
        notes=designed.given_up,
    )
