"""Designed plans: candidates of each arm, the most informative of them, their factors, pairs, order and paths.

What the stops of a plan tell, against random plans: standard errors, predictions over the workspace, observability.

Random plans have configurations as the planner with ``method: random`` samples them: uniform over those that are
visible and clear. Approach, step and time are sampled for both kinds of plan, so that only the choice of stops differs.
Predictions are judged at configurations of the workspace that were not used to choose stops and that the tracker need
not see.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.balance import correlations, travel_time
from cellapp.cell.planning.candidates import (
    COMBINED,
    CandidatePool,
    neighbours,
    random_configurations,
    sample_pool,
    workspace_configurations,
)
from cellapp.cell.planning.information import InformationModel, even_conditions, information_model, sampled_conditions
from cellapp.cell.planning.planned_stops import PlannedStops, joined_after, without_reserves
from cellapp.cell.planning.records import ArmDesign, ErrorName, ObservabilityIndices, PlanDesignResult, PlanQuality
from cellapp.cell.planning.sequence import nearest_turns, sequenced
from cellapp.cell.planning.transit_paths import ArmRoadmap, TransitPlanner
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import CellBodies, sample_spacing
from cellapp.estimation.calibration.least_squares import inverse_psd
from cellapp.estimation.calibration.parameters import determined_set
from cellapp.estimation.design.block_design import (
    Candidates,
    Criterion,
    Rows,
    choose_blocks,
    close_gaps,
    gap_limits,
    information_of,
    largest_gaps,
    least_informative_last,
    reference_errors,
    without_turns,
)
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobSteps, JobToken
from cellapp.ground.threads import one_blas_thread
from cellapp.robot.kinematics.transforms import Array

_SEED = 0xDE51
_COMPARED_SEED = 0xDE52
_SPARE_SHARE = 0.05
"""Share of stops chosen in reserve: in a crowded cell about one chosen stop in fifty cannot be reached."""
_LEAST_SPARES = 8
_ROUNDS = 3
"""Rounds in which spare stops replace those that cannot be reached."""
_LEAST_CHOICE = 3
"""Least number of easily reached candidates for each stop; with fewer there would be no choice."""
_SAMPLE = 500
"""Number of candidates whose reach is checked first."""
_FEW_HARD = 0.02
"""Share of these up to which the others are not checked: spare stops replace the few hard ones that are chosen."""


def design_stops(
    profile: Profile, count: int, job: JobToken = UNATTENDED, kept: PlannedStops | None = None
) -> tuple[PlannedStops, PlanDesignResult]:
    """Design ``count`` informative stops in a safe order, after those that are ``kept``, and describe the design.

    Parameters
    ----------
    profile : Profile
    count : int
        Number of further stops, reserves included.
    job
        Progress and cancelling.
    kept : PlannedStops, optional
        Stops that are in the plan already: their information counts before the first choice.

    Raises
    ------
    InputError
        If an arm has no candidates, or none of them can be reached.
    Cancelled
    """
    cell = cell_bodies(profile)
    before = 0 if kept is None else len(kept)
    rng = np.random.default_rng([profile.seed, _SEED, before])
    finder, pools = TransitPlanner(profile, cell, rng), {}
    with one_blas_thread():  # the products are narrow, and the arms have a core each
        for number, name in enumerate(cell.arms):
            job.tell("candidates", number, len(cell.arms), f"arm {name}")
            pools[name] = _pool(profile, _with_room(cell), finder.roadmaps[name], name, count, rng, job)
        job.tell("candidates", len(cell.arms), len(cell.arms), "done")
        spares = max(_LEAST_SPARES, math.ceil(_SPARE_SHARE * count))  # for stops that cannot be reached from the others
        chosen = select_stops(profile, pools, count + spares, rng, job, None if kept is None else kept.q)
        stops, given_up = _in_order(chosen, count, kept, finder, rng, job)
        return stops, _described(stops, given_up, pools, finder, job)


def _with_room(cell: CellBodies) -> CellBodies:
    """Enlarge the clearance: the gate samples motions, and a configuration at the very limit could not be reached."""
    return replace(cell, clearance=cell.clearance + 0.5 * sample_spacing(cell))


def _described(
    stops: PlannedStops,
    given_up: tuple[str, ...],
    pools: Mapping[str, CandidatePool],
    finder: TransitPlanner,
    job: JobToken,
) -> PlanDesignResult:
    """Compare the asked stops of a plan with random ones of the same number; reserves do not count."""
    profile = finder.profile
    rng = np.random.default_rng([profile.seed, _COMPARED_SEED])
    asked = without_reserves(profile, stops)

    def compare(name: str, own_rng: np.random.Generator) -> ArmDesign:
        return arm_design(profile, pools[name], name, asked.q, own_rng, job=job)

    job.tell("compare", 0, len(pools), "with random stops")
    arms = of_each_arm(compare, pools, rng)
    job.tell("compare", len(pools), len(pools), "done")
    return PlanDesignResult(
        arms=arms,
        correlations=correlations(profile, finder.cell, asked),
        travel=travel_time(asked, finder, rng),
        detours=sum(bool(legs) for legs in asked.legs),
        blocks=len(np.unique(asked.block)),
        repeats=int(np.sum(asked.repeat_of >= 0)),
        notes=given_up,
    )


def _in_order(
    chosen: Mapping[str, Array],
    count: int,
    kept: PlannedStops | None,
    finder: TransitPlanner,
    rng: np.random.Generator,
    job: JobToken,
) -> tuple[PlannedStops, tuple[str, ...]]:
    """Return the kept stops and ``count`` more, beginning with the first ``chosen``, and why others were given up.

    Spare stops replace those that cannot be reached. Raises ``InputError`` if fewer than the asked stops can be
    reached.
    """
    plan, stops, first, given_up = finder.profile.plan, kept, 0, list[str]()
    reached = 0 if kept is None else len(kept)
    wanted = reached + count
    for repeats in (plan.repeats, *[0] * _ROUNDS):
        part = {name: q[first : first + wanted - reached] for name, q in chosen.items()}
        first += wanted - reached
        if all(len(q) for q in part.values()):
            here = None if stops is None else stops.targets(reached - 1)
            more, reasons = sequenced(finder, part, rng, job, here, repeats)
            given_up += reasons
            if len(more):
                stops = more if stops is None else joined_after(stops, more)
                reached = len(stops)
    if stops is None or reached < wanted - plan.reserve:
        reason = f". {given_up[0]}" if given_up else ""
        raise InputError(
            f"plan: only {reached} of {counted(wanted, 'stop')} can be reached; ask for fewer stops, a smaller"
            f" plan.clearance, or move bases, tracker or obstacles{reason}"
        )
    return stops, tuple(given_up)


def _pool(
    profile: Profile,
    cell: CellBodies,
    roadmap: ArmRoadmap,
    name: str,
    count: int,
    rng: np.random.Generator,
    job: JobToken,
) -> CandidatePool:
    """Sample candidates of an arm and keep those within reach: the most informative ones lie at the ends of the joints'
    ranges, some of them in pockets (folded, behind an obstacle, the wrong way round). All are kept if these are too few
    for ``count`` stops; only the first ones are checked if hardly any of them is hard to reach."""
    pool = sample_pool(cell, profile, name, max(profile.plan.pool_size, count), rng, job)
    q = nearest_turns(profile, cell, name, pool.q)
    reached = np.ones(len(q), dtype=np.bool_)
    reached[:_SAMPLE] = roadmap.reaches(q[:_SAMPLE])
    if np.mean(reached[:_SAMPLE]) < 1.0 - _FEW_HARD:
        reached[_SAMPLE:] = roadmap.reaches(q[_SAMPLE:])
    if int(reached.sum()) < _LEAST_CHOICE * count:
        return replace(pool, q=q)
    rejected = {**pool.rejected, "hard to reach": int(np.sum(~reached))}
    return CandidatePool(q[reached], pool.sampled, rejected)


# -- Work done for each arm separately, in worker threads; the random numbers do not depend on the threads ------------


_AT_ONCE = 2
"""Number of threads: bounds the memory; more arms or cores are rare."""

Result = TypeVar("Result")


def of_each_arm(
    work: Callable[[str, np.random.Generator], Result], names: Iterable[str], rng: np.random.Generator
) -> dict[str, Result]:
    """Return arm -> ``work(arm, stream)``, each with a stream of its own that is spawned from ``rng``.

    The result is the same whichever arm is faster and however many cores there are. Matrix products and other work on
    long arrays run outside the interpreter lock. Raises what ``work`` raises for the first arm that fails.
    """
    names = tuple(names)
    with ThreadPoolExecutor(max_workers=_AT_ONCE) as threads:
        return dict(zip(names, threads.map(work, names, rng.spawn(len(names))), strict=True))


# -- Selection of the most informative stops of each arm from its pool of candidates ----------------------------------


_POINTS = 600
"""Configurations that represent the workspace: the mean is then known to 2 %, the worst point to a few percent."""
_SPREAD = 0.1
"""Standard deviation of each joint about the stops chosen so far, of the candidates that join for the first pass of
exchanges; half of it for the second [rad]. A random pool of equal quality is four times as large."""


def select_stops(
    profile: Profile,
    pools: Mapping[str, CandidatePool],
    count: int,
    rng: np.random.Generator,
    job: JobToken = UNATTENDED,
    kept: Mapping[str, Array] | None = None,
) -> dict[str, Array]:
    """Choose ``count`` configurations (n, N) [rad] of each arm, its candidates or near the best of them, the most
    informative first; fewer where its pool has fewer.

    Each arm has its own thread and its own stream of random numbers, spawned from ``rng``: the result does not depend
    on which is faster. ``kept`` are configurations (k, N) [rad] of each arm that are in the plan already: their
    information counts before the first choice, and they count in the coverage of the joints.

    Raises
    ------
    InputError
        If the profile lists an effect that no plan of this cell can show, or does not describe the cell.
    Cancelled
    """
    q = {name: pool.q for name, pool in pools.items()}

    done, total = dict.fromkeys(pools, 0), 2 * count * len(pools)
    arms = " and ".join(f"arm {name}" for name in pools)

    def tell(name: str, number: int, words: str = "") -> None:
        done[name] = number
        job.tell("select", min(sum(done.values()), total), total, arms)

    def choose(name: str, own_rng: np.random.Generator) -> Array:
        own = None if kept is None else kept.get(name)
        return _select(profile, name, q, count, own, own_rng, JobSteps(partial(tell, name), job))

    tell(next(iter(pools)), 0)
    chosen = of_each_arm(choose, pools, rng)
    job.tell("select", total, total, "done")
    return chosen


def _select(
    profile: Profile,
    name: str,
    pools: Mapping[str, Array],
    count: int,
    kept: Array | None,
    rng: np.random.Generator,
    steps: JobSteps,
) -> Array:
    """Choose configurations of one arm; ``pools`` are the candidates of all arms."""
    q, cell = pools[name], cell_bodies(profile)
    if not count or not len(q):
        return q[:0]
    conditions = even_conditions(profile, name, q, pools, rng)
    model = information_model(profile, name, q, conditions)
    kept = np.empty((0, q.shape[1])) if kept is None else kept
    before = model.rows(kept, even_conditions(profile, name, kept, pools, rng))
    candidates = Candidates(model.rows(q, conditions, np.float32), np.eye(len(model.size)) + information_of(before))
    targets = workspace_configurations(profile, cell, name, _POINTS, rng)
    criterion = Criterion(
        reference_errors(candidates.mean_information, count, candidates.prior, model.wanted),
        model.prediction_rows(targets, even_conditions(profile, name, targets, pools, rng)),
    )

    def grown(chosen: Rows, number: int) -> Candidates:
        nonlocal q, candidates
        near = neighbours(_with_room(cell), profile, name, q[chosen], _SPREAD / (1 + number), rng)
        rows = model.rows(near, even_conditions(profile, name, near, pools, rng), np.float32)
        q, candidates = np.concatenate([q, near]), replace(candidates, rows=np.concatenate([candidates.rows, rows]))
        return candidates

    chosen = choose_blocks(candidates, count, criterion, rng, steps, grown)
    limits = gap_limits(q, len(chosen) + len(kept), profile.plan.largest_gap)
    chosen = close_gaps(candidates, q, chosen, criterion, limits, without_turns(kept, q), rng, steps)
    return q[least_informative_last(candidates, chosen, criterion)]


_QUALITY_POINTS = 600
"""Number of configurations at which predictions are judged: the mean is then known to 2 %."""
_LARGER = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
"""Sizes of the random plans, relative to the judged plan; the equivalent size is interpolated among them."""
_MOST_RANDOM = 12_000
"""Upper limit of the configurations in all random plans: bounds time and memory for plans of thousands of stops."""
_SAMPLES = 4
"""Number of random plans of a size that are averaged: the worst point differs by 10 % from plan to plan. Fewer of large
plans, which differ less: as many as could be drawn apart from each other."""
_PARTS = (25, 50, 100, 200, 400, 800, 1600, 3200)
"""Numbers of stops after which the expected errors are stated."""


class Errors(NamedTuple):
    """Standard errors (k,) in units of the model's sizes; mean and largest uncertainty of predictions [m]."""

    parameters: Array
    mean: float
    worst: float


@dataclass(frozen=True, eq=False)
class DesignJudge:
    """Model, workspace points and random plans by which plans of one arm are judged.

    Attributes
    ----------
    model : InformationModel
        Columns of geometry and of the effects that the profile lists.
    points : array, shape (3 s, p)
        Derivatives of predictions [m] in single precision: uncertainties are stated to three digits.
    random : array, shape (m, 3, p)
        Whitened rows of random configurations.
    stops : mapping
        Configurations of all arms.
    rng
        Samples random plans and conditions.
    """

    model: InformationModel
    points: NDArray[np.float32]
    random: Array
    stops: Mapping[str, Array]
    rng: np.random.Generator

    @classmethod
    def of(
        cls, profile: Profile, name: str, stops: Mapping[str, Array], rng: np.random.Generator, job: JobToken
    ) -> DesignJudge:
        """Set up for plans of an arm like those ``stops``, arm -> (n, N) [rad]."""
        cell, n = cell_bodies(profile), len(stops[name])
        number = min(math.ceil(_LARGER[-1] * n), max(_MOST_RANDOM, n))
        sampled = []
        for q in islice(random_configurations(cell, profile, name, rng, COMBINED), number):
            job.check()
            sampled.append(q)
        q = np.array(sampled)
        conditions = sampled_conditions(profile, name, q, stops, rng)
        model = information_model(profile, name, q, conditions, potential=False)
        targets = workspace_configurations(profile, cell, name, _QUALITY_POINTS, rng)
        predicted = model.prediction_rows(targets, sampled_conditions(profile, name, targets, stops, rng))
        points = predicted.reshape(-1, predicted.shape[2]).astype(np.float32)
        return cls(model, points, model.rows(q, conditions), stops, rng)

    def rows(self, q: Array) -> Array:
        """Compute whitened rows (n, 3, p) of stops ``q`` (n, N) [rad] under sampled conditions."""
        return self.model.rows(q, sampled_conditions(self.model.profile, self.model.name, q, self.stops, self.rng))

    def errors(self, information: Array) -> Errors:
        """Compute the errors from the information matrix (p, p) of readings."""
        covariance = inverse_psd(np.eye(len(information)) + information)
        squares = np.einsum("rp,rp->r", self.points @ covariance.astype(np.float32), self.points)
        points = np.sqrt(squares.reshape(-1, 3).sum(axis=1))
        return Errors(np.sqrt(np.diag(covariance)), float(points.mean()), float(points.max()))

    def random_plans(self, sizes: Sequence[int]) -> dict[int, tuple[Errors, Array]]:
        """Compute mean errors and mean information matrix (p, p) of random plans, for each of the ``sizes``."""
        p = self.random.shape[2]
        found = {size: list[Errors]() for size in sizes}
        total = {size: np.zeros((p, p)) for size in sizes}
        for sample in range(_SAMPLES):
            order = self.rng.permutation(len(self.random))
            information, before = np.zeros((p, p)), 0
            for size in sorted(size for size in sizes if not sample or size * (sample + 1) <= len(order)):
                information = information + information_of(self.random[order[before:size]])
                before = size
                found[size].append(self.errors(information))
                total[size] += information
        return {size: (_mean(errors), total[size] / len(errors)) for size, errors in found.items()}

    def determined(self, information: Array) -> tuple[int, ...]:
        """Return the indices of the geometric parameters that readings with this information matrix determine.

        The others are redundant: with them the least singular value of the Jacobian would be zero.
        """
        parameters = self.model.parameters
        g = len(parameters.columns)
        size = self.model.size[:g]
        chosen = determined_set(parameters, information[:g, :g] / (size * size[:, None]), size)
        return tuple(parameters.columns.index(column) for column in chosen.columns)


def _mean(errors: Sequence[Errors]) -> Errors:
    return Errors(*(np.mean(each, axis=0) for each in zip(*errors, strict=True)))


def observability(information: Array, geometry: Sequence[int], stops: int) -> ObservabilityIndices:
    """Compute the indices from the information matrix (p, p) of ``stops`` stops.

    Only the parameters ``geometry`` count, each in units of its expected size.
    """
    chosen = np.array(geometry, dtype=np.intp)
    squares = np.linalg.eigvalsh(information[chosen[:, None], chosen])[::-1]
    s = np.sqrt(np.maximum(squares, np.finfo(np.float64).tiny))
    return ObservabilityIndices(
        o1=math.exp(float(np.mean(np.log(s)))) / math.sqrt(stops),
        o2=float(s[-1] / s[0]),
        o3=float(s[-1]),
        o4=float(s[-1] ** 2 / s[0]),
        o5=float(1.0 / np.sum(1.0 / s)),
    )


def _quality(stops: int, errors: Errors, random: Errors, indices: ObservabilityIndices) -> PlanQuality:
    """Compare the errors with those of equally many random stops (``random``)."""
    return PlanQuality(
        stops=stops,
        parameters=float(np.mean(errors.parameters / random.parameters)),
        mean_mm=1e3 * errors.mean,
        worst_mm=1e3 * errors.worst,
        indices=indices,
    )


def arm_design(
    profile: Profile,
    pool: CandidatePool,
    name: str,
    stops: Mapping[str, Array],
    rng: np.random.Generator,
    job: JobToken = UNATTENDED,
) -> ArmDesign:
    """Evaluate the stops of one arm against random ones.

    Parameters
    ----------
    profile : Profile
    pool : CandidatePool
        From which the stops were chosen.
    name : str
        The arm.
    stops : mapping
        Arm -> joint positions (n, N) [rad] in the order of the plan, of all arms.
    rng : numpy.random.Generator
    job : JobToken

    Raises
    ------
    InputError
        If the profile lists an effect that no plan of this cell can show, or does not describe the cell.
    Cancelled
    """
    q = stops[name]
    n = len(q)
    judge = DesignJudge.of(profile, name, stops, rng, job)
    rows = judge.rows(q)
    parts = [*(part for part in _PARTS if part < n), n]
    sizes = {min(round(ratio * n), len(judge.random)) for ratio in _LARGER}
    random = judge.random_plans(sorted({*parts, *sizes}))
    geometry = judge.determined(random[n][1])
    by_stops = []
    for part in parts:
        information = information_of(rows[:part])
        designed = judge.errors(information)  # at last that of all stops
        indices = observability(information, geometry, part)
        by_stops.append(_quality(part, designed, random[part][0], indices))
    equal, of_random = random[n]
    return ArmDesign(
        candidates=len(pool.q),
        drawn=pool.sampled,
        rejected=pool.rejected,
        designed=by_stops[-1],
        random=_quality(n, equal, equal, observability(of_random, geometry, n)),
        equal_to_random=equal_to_random(designed, {size: random[size][0] for size in sizes}, n),
        by_stops=tuple(by_stops),
        largest_gap=tuple(largest_gaps(without_turns(q, pool.q)).tolist()),
    )


def equal_to_random(errors: Errors, random: Mapping[int, Errors], stops: int) -> dict[ErrorName, float]:
    """Find the number of random stops with the same errors, interpolated among ``random`` plans; at most the largest.

    ``parameters`` is the mean of the standard errors, each relative to that of ``stops`` random stops.
    """
    unit = random[stops].parameters

    def three(one: Errors) -> Array:
        return np.asarray(np.log([float(np.mean(one.parameters / unit)), one.mean, one.worst]))

    sizes = sorted(random)
    curve = np.array([three(random[size]) for size in sizes])
    curve = np.minimum.accumulate(curve, axis=0)  # the mean of a few samples may rise again
    parameters, mean, worst = (
        float(np.exp(np.interp(-wanted, -curve[:, k], np.log(sizes))))
        for k, wanted in enumerate(three(errors).tolist())
    )
    return {"parameters": parameters, "mean": mean, "worst": worst}
