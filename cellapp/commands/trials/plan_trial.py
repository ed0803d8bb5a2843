"""Designed against random plans over seeds: how many random stops are as good, and the bound for any choice."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from cellapp.cell.planning.candidates import CandidatePool, draw_pool
from cellapp.cell.planning.design_records import ErrorName
from cellapp.cell.planning.designed import select_stops
from cellapp.cell.planning.plan_quality import Errors, Judge, arm_design, equal_to_random
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.commands.trials.skeleton import IN_PLACE, Work
from cellapp.commands.trials.whole_plans import WholePlan, whole_plans
from cellapp.estimation.design.block_choice import Candidates, least_errors
from cellapp.estimation.design.block_design import Criterion
from cellapp.ground.counting import counted
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken
from cellapp.ground.results import Record, Result
from cellapp.ground.scale.task import SimulatedCell, TaskKind, profile_of

BARS: Mapping[ErrorName, float] = {"parameters": 2.0, "mean": 1.5, "worst": 3.0}
"""Least number of random stops that one designed stop shall be worth, by error."""
_ROUNDS = 30
"""Iterations of the relaxation; its bound is then within 2 %."""


class PlanTrial(Record):
    """The designed stops of one arm with one seed.

    Attributes
    ----------
    equal : mapping
        Error -> number of random stops with the same error.
    bound : mapping, optional
        Error -> number of random stops with the least error that any choice of as many of the candidates has.
    largest_gap : tuple of float
        Of each joint [rad].
    seconds : float
        What the choice took.
    """

    seed: int
    arm: str
    stops: int
    candidates: int
    equal: Mapping[ErrorName, float]
    bound: Mapping[ErrorName, float] | None
    largest_gap: tuple[float, ...]
    seconds: float


class PlanTrialsResult(Result, schema="cellapp-trials-plans"):
    """``trials plans``: every seed and arm."""

    profile: str
    trials: tuple[PlanTrial, ...]
    plans: tuple[WholePlan, ...] = ()
    failed: tuple[str, ...] = ()
    """Seeds that failed, and why."""

    def complaints(self) -> list[str]:
        """Say what failed, and what whole plans must never have."""
        colliding = [
            f"seed {one.seed}: {counted(one.collisions, 'motion collides', 'motions collide')}"
            for one in self.plans
            if one.collisions
        ]
        return [*self.failed, *colliding]

    def worth(self, arm: str, error: ErrorName) -> float:
        """Return random stops that one designed stop of an arm is worth: median over seeds."""
        return float(np.median([one.equal[error] / one.stops for one in self.trials if one.arm == arm]))


class BoundedSeed(Record):
    """A seed, the number of its stops, and whether the best that any choice could reach is computed too."""

    seed: int
    stops: int
    with_bound: bool


class ArmTrials(Record):
    """The trials of all arms with one seed."""

    trials: tuple[PlanTrial, ...]


def plan_trials(
    profile: Profile,
    seeds: Sequence[int],
    stops: int = 100,
    bounded: int = 1,
    whole: int = 0,
    work: Work = IN_PLACE,
) -> PlanTrialsResult:
    """Run trials for all ``seeds``; the first ``bounded`` ones with their bounds, which take longer.

    With ``whole`` stops also make whole plans with each seed. Raises as ``gather`` and ``whole_plans`` do.
    """
    drawn = [BoundedSeed(seed=seed, stops=stops, with_bound=number < bounded) for number, seed in enumerate(seeds)]
    gathered = work.gather(DESIGNS, "plans", SimulatedCell(profile=profile), drawn)
    trials = tuple(trial for one in gathered.found for trial in one.trials)
    failed, plans = gathered.failed, tuple[WholePlan, ...]()
    if whole:
        planned = whole_plans(profile, seeds, whole, work)
        failed, plans = (*failed, *planned.failed), planned.found
    return PlanTrialsResult(profile=profile.name, trials=trials, plans=plans, failed=failed)


def plan_trial(profile: Profile, seed: int, stops: int, *, with_bound: bool = False) -> Iterator[PlanTrial]:
    """Design ``stops`` stops with a seed and judge them, arm by arm.

    Raises
    ------
    InputError
        If the cell has too few candidates, or the profile does not describe it.
    """
    cancel = CancelToken()
    profile = profile.model_copy(update={"seed": seed, "plan": profile.plan.model_copy(update={"stops": stops})})
    cell, rng = cell_bodies(profile), np.random.default_rng([seed, _SEED])
    pools = {name: draw_pool(cell, profile, name, profile.plan.pool_size, rng, cancel) for name in cell.arms}
    began = time.perf_counter()
    chosen = select_stops(profile, pools, stops, rng)
    seconds = (time.perf_counter() - began) / len(pools)
    q = {name: pools[name].q[rows] for name, rows in chosen.items()}
    for name, pool in pools.items():
        judged = arm_design(profile, pool, name, q, rng)
        yield PlanTrial(
            seed=seed,
            arm=name,
            stops=len(q[name]),
            candidates=len(pool.q),
            equal=judged.equal_to_random,
            bound=_bound(profile, pools, name, len(q[name]), rng, cancel) if with_bound else None,
            largest_gap=judged.largest_gap,
            seconds=seconds,
        )


def _trials(profile: Profile, drawn: BoundedSeed) -> ArmTrials:
    return ArmTrials(trials=tuple(plan_trial(profile, drawn.seed, drawn.stops, with_bound=drawn.with_bound)))


DESIGNS = TaskKind(
    "cellapp.commands.trials.plan_trial:DESIGNS", SimulatedCell, BoundedSeed, ArmTrials, profile_of, _trials
)

_SEED = 0x9A8
"""Mixed with the trial's seed."""


def _bound(
    profile: Profile,
    pools: Mapping[str, CandidatePool],
    name: str,
    stops: int,
    rng: np.random.Generator,
    cancel: CancelToken,
) -> dict[ErrorName, float]:
    """Return, by error, how many random stops are as good as the best weights of all candidates."""
    others = {other: pool.q for other, pool in pools.items() if other != name}
    with threadpool_limits(limits=1, user_api="blas"):
        judge = Judge.of(profile, name, others, stops, rng, cancel)
        random = {size: errors for size, (errors, _) in judge.random_plans(judge.sizes(stops)).items()}
        rows = judge.rows(pools[name].q)
        candidates = Candidates(rows, np.eye(rows.shape[2]))
        criterion = Criterion(random[stops].parameters, judge.points)
        least = least_errors(candidates, stops, criterion, _ROUNDS, cancel)
    bound = Errors(least.parameters * random[stops].parameters, least.mean, least.worst)
    return equal_to_random(bound, random, stops)
