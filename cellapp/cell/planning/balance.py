"""Balance of the planned factors: posture functions, balanced random blocks, levels without correlations.

If a factor correlates with posture, time or another factor, their effects cannot be separated. Levels are therefore not
only sampled at random: they are changed, one at a time, until the largest correlation is small.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.planned_stops import PlannedStops, route_s, stop_times_of
from cellapp.cell.planning.records import FactorCorrelation, TravelTime
from cellapp.cell.planning.transit_paths import TransitPlanner
from cellapp.cell.safety.gate import CellBodies
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.chain import frame_poses
from cellapp.robot.kinematics.statics import gravity_loads
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import bodies_of

_UP_C = np.array([0.0, 0.0, 1.0])
_CONSTANT = 1e-6
"""A column whose standard deviation is below this share of the largest one's counts as constant."""
_POWER = 6
"""Power of the correlations in the sum that is minimised: high enough that the largest ones dominate."""
_BLOCK_SAMPLES = 50
"""Number of random assignments of blocks, of which the best balanced is taken."""
_CANDIDATES = 32
"""Number of level changes whose effect is computed exactly: those with the largest gain to first order."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Variables (n, p) of n stops with mean 0 and standard deviation 1, and their names."""

    names: tuple[str, ...]
    values: Array

    def first(self, count: int) -> Columns:
        """Return the first ``count`` columns."""
        return Columns(self.names[:count], self.values[:, :count])

    def with_(self, *others: Columns) -> Columns:
        """Return these columns and the others, side by side."""
        return side_by_side((self, *others))


def side_by_side(columns: Iterable[Columns]) -> Columns:
    """Concatenate columns side by side."""
    every = tuple(columns)
    return Columns(sum((one.names for one in every), ()), np.concatenate([one.values for one in every], axis=1))


def standardised(names: tuple[str, ...], values: Array) -> Columns:
    """Standardise the columns of ``values`` (n, p) to mean 0 and standard deviation 1; leave out constant ones."""
    centred = values - values.mean(axis=0)
    spread = np.sqrt(np.mean(centred**2, axis=0))
    varies = spread > _CONSTANT * max(float(spread.max(initial=0.0)), 1e-300)
    kept = tuple(name for name, one in zip(names, varies.tolist(), strict=True) if one)
    return Columns(kept, np.asarray(centred[:, varies] / spread[varies]))


def posture_functions(profile: Profile, cell: CellBodies, name: str, q: Array) -> Columns:
    """Compute sine, cosine and gravity torque of each joint at configurations ``q`` (n, N) [rad] of an arm.

    Effects that depend on posture are, to first order, combinations of these. Constant ones are left out.
    """
    arm = cell.arms[name]
    torques = gravity_loads(frame_poses(arm.geometry, q), bodies_of(profile.arms[name]), _UP_C).joint_torques()
    groups = (("sin q{}", np.sin(q)), ("cos q{}", np.cos(q)), ("gravity torque {}", torques))
    return side_by_side(
        standardised(tuple(f"{text.format(j + 1)} of {name}" for j in range(q.shape[1])), values)
        for text, values in groups
    )


def time_and_blocks(time: Array, block: NDArray[np.intp]) -> Columns:
    """Return time, and for each block an indicator against the others."""
    numbers = np.unique(block)
    blocks = (block[:, None] == numbers).astype(np.float64) if len(numbers) > 1 else np.zeros((len(block), 0))
    names = ("time", *(f"block {number + 1}" for number in range(blocks.shape[1])))
    return standardised(names, np.column_stack([time, blocks]))


def fair_blocks(features: Array, sizes: NDArray[np.intp], rng: np.random.Generator) -> NDArray[np.intp]:
    """Assign a block (n,) to each stop at random, so that each block gets its share of similar stops.

    Within each group of similar stops, the block of each is sampled at random (a randomised block design); of many
    samples the one whose blocks have the most equal means is taken (rerandomisation: Morgan, Rubin, Annals of
    Statistics 40 (2012) 1263).

    Parameters
    ----------
    features : array, shape (n, p)
        Functions of posture with mean 0; similar stops have similar ones.
    sizes : array, shape (B,)
        Number of stops of each block, at most one apart; their sum is n.
    rng : numpy.random.Generator
    """
    count, longer = len(sizes), np.flatnonzero(sizes > sizes.min())
    groups = _similar(features, count)
    best, least = np.zeros(len(features), dtype=np.intp), np.inf
    for _ in range(_BLOCK_SAMPLES if count > 1 else 0):
        block = np.empty(len(features), dtype=np.intp)
        for rows in groups:  # an incomplete group goes to the blocks that have one stop more
            block[rows] = rng.permutation(count if len(rows) == count else longer)
        unfair = float(np.sum(((np.arange(count)[:, None] == block) @ features / sizes[:, None]) ** 2))
        if unfair < least:
            best, least = block, unfair
    return best


def _similar(features: Array, size: int) -> list[NDArray[np.intp]]:
    """Split the stops into groups of ``size`` similar ones, by repeated halving along the direction of largest spread.

    The last group is smaller if the number of stops is no multiple of ``size``.
    """
    found, waiting = [], [np.arange(len(features))]
    while waiting:
        rows = waiting.pop()
        if len(rows) <= size:
            found.append(rows)
            continue
        centred = features[rows] - features[rows].mean(axis=0)
        along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
        cut = size * max(1, round(len(rows) / (2 * size)))
        ranked = rows[np.argsort(along, kind="stable")]
        waiting += [ranked[:cut], ranked[cut:]]
    return found


def balanced_levels(
    scores: Array, allowed: NDArray[np.bool_], against: Array, rng: np.random.Generator, goal: float
) -> NDArray[np.intp]:
    """Choose a level for each of n stops, balanced and with small correlations; return the indices of the levels (n,).

    Random levels are changed one at a time, each time by the change that most reduces the sum of the sixth powers of
    the correlations, until the largest is at most ``goal`` or nothing improves.

    Parameters
    ----------
    scores : array, shape (L, m)
        The m measures of each level, with mean 0 and standard deviation 1.
    allowed : array, shape (n, L), bool
        Levels that each stop may have, at least one.
    against : array, shape (m, n, p)
        Variables for each measure with mean 0 and standard deviation 1; a column of ones balances the levels
        themselves.
    rng : numpy.random.Generator
    goal : float
        Largest correlation that is small enough.
    """
    n, levels = allowed.shape
    if n == 0 or levels < 2:
        return np.asarray(np.argmax(allowed, axis=1))
    chosen = np.argmax(allowed * rng.random(allowed.shape), axis=1)
    correlation = np.einsum("nm,mnp->mp", scores[chosen], against) / n
    for _ in range(n * levels):
        if np.abs(correlation).max(initial=0.0) <= goal:
            break
        change = np.where(allowed[..., None], scores - scores[chosen][:, None], 0.0) / n
        slope = np.stack(
            [its @ of_its for its, of_its in zip(against, correlation ** (_POWER - 1), strict=True)], axis=1
        )
        gain = np.einsum("nlm,nm->nl", change, slope)
        likely = np.argpartition(gain, min(_CANDIDATES, gain.size - 1), axis=None)[:_CANDIDATES]
        stop, level = np.unravel_index(likely, gain.shape)
        after = correlation + change[stop, level][..., None] * against[:, stop].swapaxes(0, 1)
        total = np.sum(_sixth_power(after), axis=(1, 2))
        best = int(np.argmin(total))
        if total[best] >= np.sum(_sixth_power(correlation)):
            break
        chosen[stop[best]], correlation = level[best], after[best]
    return np.asarray(chosen)


# -- Planned factors of each stop: side and size of each joint's last motion, rest before the measurement -------------
#
# In the last motion all arms move at once from ``approach_from``: the stop minus a signed step of each joint. The
# levels are balanced, and decorrelated from posture, time, block, the other arms and each other, so that the effect of
# one factor is not mistaken for that of another. Repeats of a stop are approached from the other side of every joint.


_GOAL = 0.06
"""Correlation at which the search for levels ends: low, as some levels must change later where the gate refuses."""
_OTHER_STEPS = 40
"""Number of other sides and sizes that are sampled for a stop whose last motion the gate refuses."""
_IMPROVED = 0.08
"""Largest correlation left in the plan: below the accepted one, as times are only estimates."""
_IMPROVEMENTS = 300
"""Upper limit of changes of single steps; each takes about a millisecond."""
_TRIED_CHANGES = 10
"""Number of stops at which a change of one factor is tried before it is given up."""
_SMALLEST_RAD = 1e-9
"""Lower limit of spreads, in place of 0."""


Accepts = Callable[[int, Mapping[str, Array]], bool]
"""Callback: given a stop and new signed steps of its last motion, arm -> (N,) [rad], whether the gate accepts them."""


class FactorPlan:
    """Levels of the factors of n stops in their order, arm -> q (n, N) [rad]."""

    def __init__(
        self,
        profile: Profile,
        cell: CellBodies,
        q: Mapping[str, Array],
        block: NDArray[np.intp],
        repeat_of: NDArray[np.intp],
        rng: np.random.Generator,
    ) -> None:
        self._profile, self._q, self._rng = profile, q, rng
        self._limits = {name: cell.arms[name].limits for name in q}
        self._sizes = np.unique(profile.plan.steps)
        self._repeat_of = repeat_of
        self._first = np.flatnonzero(repeat_of < 0)
        """Stops whose levels are free; repeats take theirs from these."""
        time = time_and_blocks(np.arange(len(block), dtype=np.float64), block)
        postures = [posture_functions(profile, cell, name, rows) for name, rows in q.items()]
        self._against = side_by_side((*postures, time)).values

    def dwell_s(self, step: Mapping[str, Array]) -> dict[str, Array]:
        """Choose the rest before measuring at each stop, arm -> (n,) [s]: the same for all arms, as these wait."""
        levels = np.unique(self._profile.plan.dwell)
        n = len(self._repeat_of)
        steps = _levels_of(np.concatenate(list(step.values()), axis=1))
        against = np.column_stack([self._against, steps, np.ones(n)])[None]
        scores = standardised(("dwell",), levels[:, None]).values
        chosen = balanced_levels(scores, np.ones((n, len(levels)), dtype=np.bool_), against, self._rng, _GOAL)
        return {name: levels[chosen].copy() for name in self._q}

    def approaches(self) -> dict[str, Array]:
        """Choose signed steps of the last motions, balanced in side and size, arm -> (n, N) [rad]; 0: the joint rests.

        They begin inside the joint limits; nothing else is checked. A repeat gets the opposite step.
        """
        step = {name: np.zeros_like(q) for name, q in self._q.items()}
        levels, against, first = np.concatenate([-self._sizes, self._sizes]), self._against, self._first
        copies = np.flatnonzero(self._repeat_of >= 0)
        source = self._repeat_of[copies]
        for name, q in self._q.items() if len(levels) else ():
            for joint, (low, high) in enumerate(self._limits[name]):
                begin = q[:, joint, None] - levels
                fits = (begin >= low) & (begin <= high)
                fits[source] &= np.roll(fits[source], len(self._sizes), axis=1)
                every = np.column_stack([against, np.ones(len(q))])
                folds = []
                for sign in (-1.0, 1.0, -1.0):  # the sides and signed steps of a stop and its repeat cancel
                    fold = every.copy()
                    np.add.at(fold, source, sign * every[copies])
                    folds.append(fold[first])
                usable = np.where(fits.any(axis=1, keepdims=True), fits, True)[first]
                chosen = balanced_levels(_levels_of(levels[:, None]), usable, np.stack(folds), self._rng, _GOAL)
                step[name][first, joint] = np.where(fits[first].any(axis=1), levels[chosen], 0.0)
                step[name][copies, joint] = -step[name][source, joint]
                against = np.column_stack([against, _levels_of(step[name][:, [joint]])[:, :2]])
        return step

    def other_steps(self, step: Mapping[str, Array], stop: int) -> dict[str, Array]:
        """Sample other signed steps of one stop within limits, arm -> (m, N) [rad], best balanced first."""
        if len(self._sizes) == 0:
            return {name: np.zeros((0, q.shape[1])) for name, q in self._q.items()}
        own, q = (np.concatenate([rows[stop] for rows in of_arm.values()]) for of_arm in (step, self._q))
        low, high = np.concatenate([self._limits[name] for name in self._q]).T
        shape = _OTHER_STEPS, len(own)
        sampled = _inside(q, self._rng.choice(np.concatenate([-self._sizes, self._sizes]), shape), low, high)
        present = np.concatenate(list(step.values()), axis=1)
        scale = np.maximum(np.sqrt(np.mean(present**2, axis=0)), _SMALLEST_RAD)
        correlation = self._against.T @ (present / scale) / len(present)
        change = self._against[stop][:, None] * ((sampled - own) / scale)[:, None, :] / len(present)
        ranked = sampled[np.argsort(np.sum(_sixth_power(correlation + change), axis=(1, 2)), kind="stable")]
        ends = np.cumsum([rows.shape[1] for rows in self._q.values()])[:-1]
        return dict(zip(self._q, np.split(ranked, ends, axis=1), strict=True))

    def improve(self, step: Mapping[str, Array], changeable: NDArray[np.bool_], accepts: Accepts) -> None:
        """Change steps of single joints, if the gate accepts, until no correlation exceeds ``_IMPROVED``.

        Only stops that are ``changeable`` (n,) and are not visited twice are changed; ``step`` is changed in place.
        """
        twice = np.isin(np.arange(len(changeable)), self._repeat_of) | (self._repeat_of >= 0)
        rows = np.flatnonzero(changeable & ~twice)
        joints = [(name, j) for name, q in self._q.items() for j in range(q.shape[1])]
        stuck: set[int] = set()
        for _ in range(_IMPROVEMENTS if len(self._sizes) and len(rows) else 0):
            levels = _levels_of(np.concatenate(list(step.values()), axis=1))
            every, correlation = self._correlations(levels)
            largest = np.abs(correlation).max(axis=0)
            largest[list(stuck)] = 0.0
            column = int(np.argmax(largest))
            if largest[column] <= _IMPROVED:
                break
            name, joint = joints[column % len(joints)]
            measure = _MEASURES[column // len(joints)]
            if self._change_one(step, rows, name, joint, measure, every, correlation[:, column], accepts):
                stuck.clear()
            else:
                stuck.add(column)

    def _correlations(self, levels: Array) -> tuple[Array, Array]:
        """Return all variables (n, q), and their correlations (q, 3 J) with the ``levels`` (n, 3 J) of the factors.

        Signed steps are compared with posture, time and blocks alone, as they follow from sides and sizes.
        """
        every = np.concatenate([self._against, levels], axis=1)
        correlation = every.T @ levels / len(levels)
        own = correlation[self._against.shape[1] :]
        np.fill_diagonal(own, 0.0)
        signed = 2 * levels.shape[1] // 3
        own[signed:], own[:, signed:] = 0.0, 0.0
        return every, correlation

    def _change_one(
        self,
        step: Mapping[str, Array],
        rows: NDArray[np.intp],
        name: str,
        joint: int,
        measure: Callable[[Array], Array],
        every: Array,
        correlation: Array,
        accepts: Accepts,
    ) -> bool:
        """Change side or size of one joint at the accepted stop where that helps most; False if there is none."""
        present = step[name][rows, joint]
        scale = len(every) * max(float(np.std(measure(step[name][:, joint]))), _SMALLEST_RAD)
        compared, found = np.where(correlation == 0.0, 0.0, every[rows]), []
        for other in (-present, *(np.sign(present) * size for size in self._sizes.tolist())):
            change = (measure(other) - measure(present)) / scale
            after = correlation + change[:, None] * compared
            total = np.where(change != 0.0, np.sum(_sixth_power(after), axis=1), np.inf)
            found += list(zip(total.tolist(), rows.tolist(), other.tolist(), strict=True))
        low, high = self._limits[name][joint]
        for total_after, stop, value in sorted(found)[:_TRIED_CHANGES]:
            if total_after >= np.sum(_sixth_power(correlation)):
                return False
            steps = {arm: one[stop].copy() for arm, one in step.items()}
            steps[name][joint] = value
            if low <= self._q[name][stop, joint] - value <= high and accepts(stop, steps):
                step[name][stop, joint] = value
                return True
        return False


def _sixth_power(values: Array) -> Array:
    """Raise to the sixth power, so that the largest dominate a sum. Products are many times faster than powers."""
    squares = values * values
    return squares * squares * squares


def _inside(q: Array, step: Array, low: Array, high: Array) -> Array:
    """Reverse steps (m, N) that start outside the limits; 0 if that does not help."""
    flipped = np.where((q - step >= low) & (q - step <= high), step, -step)
    return np.asarray(np.where((q - flipped >= low) & (q - flipped <= high), flipped, 0.0))


_MEASURES: tuple[Callable[[Array], Array], ...] = (np.sign, np.abs, np.positive)
"""The levels of a signed step: the side, the size, both."""


def _levels_of(step: Array) -> Array:
    """Standardise sides, sizes and both of signed steps (n, J) to mean 0 and deviation 1, (n, 3 J); 0 if constant."""
    levels = np.concatenate([measure(step) for measure in _MEASURES], axis=1)
    centred = levels - levels.mean(axis=0)
    spread = centred.std(axis=0)
    return np.asarray(np.where(spread > _SMALLEST_RAD, centred / np.maximum(spread, _SMALLEST_RAD), 0.0))


# ---------------------------------------------------------------------------------------------------------------------
# Correlations of a plan's factors with posture, time, block and each other; its time against that of random orders.


_SAMPLED_WAYS = 40
"""Upper limit of the motions between random stops that are searched for detours: some of them need one."""
_SAMPLED_A_STOP = 2
"""Such motions for each stop: in a small plan they say as much as all of its motions."""
_RANDOM_ORDERS = 20
"""Number of random orders whose time is averaged: the standard deviation is then a few tenths of a percent."""


def correlations(profile: Profile, cell: CellBodies, stops: PlannedStops) -> tuple[FactorCorrelation, ...]:
    """Find the largest correlation of each factor that a plan chooses: of each arm, and of all (arm "all").

    Factors that do not vary are left out.
    """
    time = stop_times_of(profile, stops).measured_s
    common = time_and_blocks(time, stops.block)
    postures = {name: posture_functions(profile, cell, name, q) for name, q in stops.q.items()}
    steps = {name: np.nan_to_num(q - stops.approach_from[name]) for name, q in stops.q.items()}
    sides = {name: _of_joints("approach side of joint {} of " + name, np.sign(step)) for name, step in steps.items()}
    sizes = {name: _of_joints("step size of joint {} of " + name, np.abs(step)) for name, step in steps.items()}
    signed = {name: _of_joints("step of joint {} of " + name, step) for name, step in steps.items()}
    dwell = standardised(("dwell",), next(iter(stops.dwell_s.values()))[:, None])
    every_posture = side_by_side(postures.values())
    chosen = common.with_(dwell, *sides.values(), *sizes.values())
    found = [
        *_largest("all", common.first(1), every_posture),
        *_largest("all", dwell, every_posture.with_(common, *sides.values())),
    ]
    for name in stops.q:
        others = [posture for other, posture in postures.items() if other != name]
        for own in (sides[name], sizes[name]):
            found += _largest(name, own, every_posture.with_(chosen))
        found += _largest(name, signed[name], every_posture.with_(common, dwell))
        if others:
            found += sorted(
                _largest(name, postures[name], side_by_side(others)), key=lambda one: -abs(one.correlation)
            )[:1]
    return tuple(found)


def travel_time(stops: PlannedStops, finder: TransitPlanner, rng: np.random.Generator) -> TravelTime:
    """Compute the time in motion of a plan, and of the same pairs, approaches and dwells in random order.

    In random order, too, the gate refuses some straight motions; the time of their detours is estimated from a sample.
    """
    profile, straight = finder.profile, replace(stops, legs=((),) * len(stops))
    orders = (straight.take(rng.permutation(len(stops))) for _ in range(_RANDOM_ORDERS))
    random_s = float(np.mean([stop_times_of(profile, order).travel_s for order in orders]))
    detours_s = len(stops) * _added_by_a_detour_s(stops, finder, rng)
    return TravelTime(planned_s=stop_times_of(profile, stops).travel_s, random_order_s=random_s + detours_s)


def _added_by_a_detour_s(stops: PlannedStops, finder: TransitPlanner, rng: np.random.Generator) -> float:
    """Estimate the mean time that detours add to motions between random stops [s], where one is found."""
    if len(stops) < 2:
        return 0.0
    number = min(_SAMPLED_WAYS, _SAMPLED_A_STOP * len(stops))
    pairs = [rng.choice(len(stops), 2, replace=False).tolist() for _ in range(number)]
    motions = [(stops.targets(here), stops.targets(there)) for here, there in pairs]
    finder.gate.ask(motions)
    added = []
    for here, there in motions:
        legs = finder.find(here, there)
        if not isinstance(legs, str):
            straight_s = route_s(finder.profile, here, (there,))
            added.append(route_s(finder.profile, here, (*legs, there)) - straight_s)
    return float(np.mean(added)) if added else 0.0


def _of_joints(text: str, values: Array) -> Columns:
    return standardised(tuple(text.format(j + 1) for j in range(values.shape[1])), values)


def _largest(arm: str, factors: Columns, others: Columns) -> Iterator[FactorCorrelation]:
    """Yield the largest correlation of each factor with one of the others that is not itself."""
    if not others.names:
        return
    correlation = factors.values.T @ others.values / max(len(factors.values), 1)
    for name, row in zip(factors.names, correlation, strict=True):
        size = np.where(np.array([other == name for other in others.names]), -1.0, np.abs(row))
        k = int(np.argmax(size))
        if size[k] >= 0.0:
            yield FactorCorrelation(
                arm=arm, factor=name, other=others.names[k], correlation=float(row[k]), can_be_chosen=True
            )
