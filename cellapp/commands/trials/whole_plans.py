"""Whole plans over seeds, designed against random: stops, travel, correlations, an independent collision check."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cellapp.cell.planning.balance import correlations
from cellapp.cell.planning.design_records import FactorCorrelation
from cellapp.cell.planning.method import make_stops
from cellapp.cell.planning.planned_stops import Configuration, PlannedStops
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.commands.trials.collision_check import CollisionCheck
from cellapp.commands.trials.skeleton import IN_PLACE, Work
from cellapp.ground.profile import Profile
from cellapp.ground.results import Record
from cellapp.ground.scale.gather import Gathered
from cellapp.ground.scale.task import SimulatedCell, TaskKind, profile_of
from cellapp.robot.kinematics.transforms import Array

_SEED = 0x9A9
"""Mixed with the trial's seed."""
_TIMINGS = 2
"""Runs of each motion in the check: all arms in step, and once with one arm late and at another speed."""


class WholePlan(Record):
    """One designed plan of all arms, beside the random plan of the same seed.

    ``correlation``, ``random_correlation``: largest of the factors that can be chosen (0 where none varies).
    ``travel_s``, ``random_order_s``: time in motion, and of the same stops in random order [s].
    ``motions``, ``collisions``: motions of the designed plan, and those that the independent check refuses.
    """

    seed: int
    asked: int
    reached: int
    seconds: float
    rejected: float
    """Share of the drawn configurations that are no candidates, mean over arms."""
    travel_s: float
    random_order_s: float
    correlation: float
    random_correlation: float
    detours: int
    motions: int
    collisions: int

    @property
    def saved(self) -> float:
        """Share of travel time that the order saves."""
        return 1.0 - self.travel_s / max(self.random_order_s, 1e-12)


class PlanSeed(Record):
    """A seed, and the stops of its plan."""

    seed: int
    stops: int


def whole_plans(
    profile: Profile,
    seeds: Sequence[int],
    stops: int,
    work: Work = IN_PLACE,
) -> Gathered[WholePlan]:
    """Plan ``stops`` stops with each seed.

    Raises
    ------
    InputError
        If the package of the independent check is missing, or not enough stops can be reached with any seed.
    Cancelled
    """
    drawn = [PlanSeed(seed=seed, stops=stops) for seed in seeds]
    return work.gather(PLANS, "whole plans", SimulatedCell(profile=profile), drawn, "whole plan, seed {0.seed}")


def _whole_plan(profile: Profile, drawn: PlanSeed) -> WholePlan:
    seed, stops = drawn.seed, drawn.stops

    def asked(method: str) -> Profile:
        plan = profile.plan.model_copy(update={"stops": stops, "reserve": 0, "method": method})
        return profile.model_copy(update={"seed": seed, "plan": plan})

    check = CollisionCheck(profile)
    began = time.perf_counter()
    planned, design = make_stops(asked("designed"))
    seconds = time.perf_counter() - began
    assert design is not None, "a designed plan has a result"
    random, _ = make_stops(asked("random"))
    homes = home_positions(profile)
    motions = planned_motions(planned, homes)
    arms = design.arms.values()
    return WholePlan(
        seed=seed,
        asked=stops,
        reached=len(planned),
        seconds=seconds,
        rejected=float(np.mean([1.0 - arm.candidates / max(arm.drawn, 1) for arm in arms])),
        travel_s=design.travel.planned_s,
        random_order_s=design.travel.random_order_s,
        correlation=_largest(design.correlations),
        random_correlation=_largest(correlations(profile, cell_bodies(profile), as_driven(random, homes))),
        detours=design.detours,
        motions=len(motions),
        collisions=sum(1 for _ in check.collisions(motions, np.random.default_rng([seed, _SEED]), timings=_TIMINGS)),
    )


PLANS = TaskKind(
    "cellapp.commands.trials.whole_plans:PLANS", SimulatedCell, PlanSeed, WholePlan, profile_of, _whole_plan
)


def planned_motions(stops: PlannedStops, homes: Configuration) -> list[tuple[dict[str, Array], dict[str, Array]]]:
    """Return all motions of a plan from home and back, each from the positions of all arms to their next ones."""
    here = {name: homes.get(name, q[0]) for name, q in stops.q.items()}
    motions = []
    for stop in range(len(stops)):
        targets = stops.targets(stop)
        for leg in (*stops.legs[stop], {**targets, **stops.approach_starts(stop)}, targets):
            there = {**here, **leg}
            motions.append((here, there))
            here = there
    return [*motions, (here, {**here, **homes})]


def as_driven(stops: PlannedStops, homes: Configuration) -> PlannedStops:
    """Return a plan without approaches whose last motions are the whole motions, so that their sides can be judged."""
    begin = {name: np.vstack([homes.get(name, q[0]), q[:-1]]) for name, q in stops.q.items()}
    return replace(stops, approach_from=begin)


def _largest(found: Sequence[FactorCorrelation]) -> float:
    return max((abs(one.correlation) for one in found if one.can_be_chosen), default=0.0)
