"""The pool of candidates: configurations of one arm that the tracker sees and at which the arm is clear."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.bodies import (
    AZIMUTH,
    ELEVATION,
    FACING,
    RANGE,
    ArmBodies,
    Placed,
    Sight,
    TrackerField,
    beam_clearance,
    height_clearance,
    mounted_hides,
    place,
    self_clearance,
    sight_conditions,
    sight_of,
    usable_acceptance,
)
from cellapp.cell.safety.gate import BEAM_RADIUS, CellBodies, clear_alone
from cellapp.cell.safety.shapes import ObstacleBody, beam_gaps
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.robot.kinematics.chain import flange_poses
from cellapp.robot.kinematics.transforms import Array

_ROUNDING_M = 1e-9
"""Tolerance of distances for rounding, where exact conditions follow [m]."""
_OBLIQUE_SHARE = 0.25
"""Share of the configurations beyond the incidence of full accuracy that is kept: they are measured worse, but without
them effects of the incidence could not be seen."""
INDEPENDENT = 4000, 1
"""Groups drawn at once and draws in each: about 60 of 4000 single ones are usable in the twin cell."""
COMBINED = 64, 16
"""The same where the first joints of each draw of a group are combined with the other joints of each, so that the
trigonometry is done once for many configurations; what is computed from them fits in the cache."""
_NEIGHBOURS = 12
"""Samples about each configuration; half of them are usable."""
_MOST_SAMPLES = 800_000
_MOST_SAMPLES_PER_CANDIDATE = 400
"""Samples after which the search ends: four times the number that a candidate takes in the twin cell, some seconds."""


@dataclass(frozen=True, eq=False)
class CandidatePool:
    """m configurations of one arm, each visible and clear without regard to other arms.

    Attributes
    ----------
    q : array, shape (m, N)
        Joint positions [rad].
    sampled : int
        Configurations sampled to find them.
    rejected : mapping
        Constraint -> how many of those sampled it excluded. A configuration counts for the first that excludes it, in
        the order of the mapping.
    """

    q: Array
    sampled: int
    rejected: Mapping[str, int]


def sample_pool(
    cell: CellBodies, profile: Profile, name: str, count: int, rng: np.random.Generator, job: JobToken = UNATTENDED
) -> CandidatePool:
    """Sample ``count`` candidates of an arm in random order, fewer where they are rare.

    Each is uniform in the joint ranges of the plan, restricted to configurations that are visible and clear; of those
    with an incidence above ``plan.incidence`` a quarter is kept. Some have joint positions in common with a few others.

    Raises
    ------
    InputError
        If fewer are found than the plan has stops; the message says which constraint excludes them.
    Cancelled
    """

    def keep(incidence: Array) -> NDArray[np.bool_]:
        lucky = rng.random(len(incidence)) < _OBLIQUE_SHARE
        return np.asarray(lucky | (incidence <= profile.plan.incidence))

    found, number, sampled = list[CandidatePool](), 0, 0
    low, high = joint_ranges(cell, profile, name).T
    most = max(_MOST_SAMPLES, count * _MOST_SAMPLES_PER_CANDIDATE)
    while number < count and sampled < most:
        job.check()
        found.append(_usable(cell, name, _samples(low, high, COMBINED, rng), keep))
        number, sampled = number + len(found[-1].q), sampled + found[-1].sampled
    if number < min(count, profile.plan.stops + profile.plan.reserve):
        raise InputError(shortage(cell, profile, name, number, sampled))
    q = np.concatenate([one.q for one in found])[rng.permutation(number)[:count]]
    rejected = {constraint: sum(one.rejected[constraint] for one in found) for constraint in found[0].rejected}
    return CandidatePool(q, sampled, rejected)


def neighbours(
    cell: CellBodies, profile: Profile, name: str, q: Array, spread: float, rng: np.random.Generator
) -> Array:
    """Sample usable configurations (m, N) [rad] of an arm about those ``q`` (n, N): each joint that may move differs
    with a standard deviation ``spread`` [rad]."""
    low, high = joint_ranges(cell, profile, name).T if profile.plan.ranges is not None else cell.arms[name].limits.T
    near = np.repeat(q, _NEIGHBOURS, axis=0)
    near += rng.normal(0.0, spread, near.shape) * (high > low)
    inside = np.all((near >= low) & (near <= high), axis=1)
    return _usable(cell, name, near[inside, None]).q


def random_configurations(
    cell: CellBodies, profile: Profile, name: str, rng: np.random.Generator, groups: tuple[int, int] = INDEPENDENT
) -> Iterator[Array]:
    """Yield usable configurations (N,) [rad] of an arm without end, uniform in the plan's joint ranges; independent
    of each other unless draws are combined in ``groups``.

    Raises
    ------
    InputError
        If none is found in many samples; the message says which constraint excludes them.
    """
    low, high = joint_ranges(cell, profile, name).T
    fruitless = 0
    while True:
        usable = _usable(cell, name, _samples(low, high, groups, rng))
        yield from usable.q[::-1]  # this order belongs to the seed: a profile gives the same plan each time
        fruitless = 0 if len(usable.q) else fruitless + usable.sampled
        if fruitless >= _MOST_SAMPLES:
            raise InputError(shortage(cell, profile, name, 0, fruitless))


def _samples(low: Array, high: Array, groups: tuple[int, int], rng: np.random.Generator) -> Array:
    """Draw ``groups`` (b, g, N) [rad] uniformly between ``low`` and ``high`` (N,); g is 1 where half of them rest."""
    moves = np.split(high > low, [_first_joints(len(low))])
    b, g = groups if all(half.any() for half in moves) else (math.prod(groups), 1)
    return rng.uniform(low, high, size=(b, g, len(low)))


def _first_joints(joints: int) -> int:
    """Number of joints that count as the first ones."""
    return max(1, joints // 2)


def _facing(arm: ArmBodies, T_C_M: Array, q: Array) -> Array:
    """Combine in each group of ``q`` (b, g, N) [rad] the first joints of each draw with the others of each.

    Return the configurations (n, N) whose SMR faces a tracker at ``T_C_M`` (4, 4), but for rounding.
    """
    s, geometry, flat = _first_joints(q.shape[2]), arm.geometry, q.reshape(-1, q.shape[2])
    wrist = replace(geometry, base=np.zeros(6), rows=geometry.rows[s:], reference_axis=2)
    (R, o), (R_wrist, o_wrist) = (
        [part.reshape(*q.shape[:2], *part.shape[1:]) for part in flange_poses(chain, own)]
        for chain, own in zip((replace(geometry, rows=geometry.rows[:s]), wrist), np.split(flat, [s], axis=1))
    )
    # all in the frame of the last of the first joints: (b, g, 3)
    tracker = np.einsum("bgac,bga->bgc", R, T_C_M[:3, 3] - o)
    normal, smr = R_wrist @ arm.normal_F, o_wrist + R_wrist @ geometry.tool
    squares = [np.einsum("bga,bga->bg", one, one) for one in (tracker, smr)]
    square = squares[0][:, :, None] + squares[1][:, None] - 2.0 * (tracker @ smr.transpose(0, 2, 1))
    towards = tracker @ normal.transpose(0, 2, 1) - np.einsum("bga,bga->bg", smr, normal)[:, None]
    least = math.cos(usable_acceptance(arm.acceptance)) * np.sqrt(np.maximum(square, 0.0))
    group, i, k = np.nonzero(towards > least - _ROUNDING_M)
    return np.concatenate([q[group, i, :s], q[group, k, s:]], axis=1)


def joint_ranges(cell: CellBodies, profile: Profile, name: str) -> Array:
    """Return the ranges from which the joint positions of an arm are sampled, lowest and highest, shape (N, 2) [rad].

    Raises
    ------
    InputError
        If a range of the plan is outside the arm's limits.
    """
    limits = cell.arms[name].limits
    if profile.plan.ranges is None:  # poses repeat after one turn of a joint: stay as near to zero as the limits allow
        middle = np.clip(0.0, limits[:, 0] + math.pi, limits[:, 1] - math.pi)
        return np.stack(
            [np.maximum(limits[:, 0], middle - math.pi), np.minimum(limits[:, 1], middle + math.pi)], axis=1
        )
    low, high = np.array(profile.plan.ranges).T
    ranges = np.stack([np.maximum(low, limits[:, 0]), np.minimum(high, limits[:, 1])], axis=1)
    for j in np.flatnonzero(ranges[:, 0] > ranges[:, 1]):
        raise InputError(
            f"plan.ranges: joint {j + 1}: no part of [{low[j]:g}, {high[j]:g}] rad is inside the limits of arm {name}"
        )
    return ranges


# -- Selection of the configurations of one arm that can be measured: cheap and selective conditions come first -------


FLOOR, CEILING, OWN_BODIES = "floor", "ceiling", "own bodies"
OWN_BEAM, MOUNTED = "own arm in the beam", "mounted obstacle in the beam"
"""Constraints that bodies set; each obstacle adds two more, under its name."""
INCIDENCE = "incidence"
"""Name under which measurable configurations are counted that are left out to prefer smaller angles of incidence."""


def _usable(
    cell: CellBodies, name: str, groups: Array, keep: Callable[[Array], NDArray[np.bool_]] | None = None
) -> CandidatePool:
    """Select the usable ones of the combinations of groups ``groups`` (b, g, N) of draws; ``keep`` decides by incidence
    (m,) [rad] what to keep.

    Most face away from the tracker: that is found first, without bodies. The constraints are those of the safety gate.
    """
    arm, field, sampled = cell.arms[name], _field(cell, name), groups.shape[0] * groups.shape[1] ** 2
    q = _facing(arm, field.T_C_M, groups)
    rows, rejected = np.arange(len(q)), {FACING: sampled - len(q)}

    def only(constraint: str, holds: NDArray[np.bool_]) -> NDArray[np.intp]:
        rejected[constraint] = rejected.get(constraint, 0) + len(rows) - int(np.count_nonzero(holds))
        return rows[holds]

    placed = place(arm, q)
    sight = sight_of(field.T_C_M, placed)
    for constraint, holds in sight_conditions(field, arm.acceptance, sight):
        rows = only(constraint, holds[rows])
    if keep is not None:
        rows = only(INCIDENCE, keep(sight.incidence[rows]))
    placed = placed.take(rows)
    for constraint, margin in body_margins(cell, field, name).items():
        clear = margin(placed) > 0.0  # not for NaN
        rows, placed = only(constraint, clear), placed.take(clear)
    return CandidatePool(q[rows], sampled, rejected)


def _field(cell: CellBodies, name: str) -> TrackerField:
    if cell.field is None:
        raise InputError(f"plan: arm {name}: the cell has no tracker that could see its SMR; give tracker.pose")
    return cell.field


def body_margins(cell: CellBodies, field: TrackerField, name: str) -> Mapping[str, Callable[[Placed], Array]]:
    """Map each constraint to the margin of an arm [m] at n configurations, shape (n,); negative where it is violated.

    Infinite where there is no distance: without bodies, and for what is mounted beside the SMR.
    """
    tracker, arm = field.T_C_M[:3, 3], cell.arms[name]
    margins: dict[str, Callable[[Placed], Array]] = {
        FLOOR: lambda placed: height_clearance(placed, floor=cell.floor) - cell.clearance,
        CEILING: lambda placed: height_clearance(placed, ceiling=cell.ceiling) - cell.clearance,
        OWN_BEAM: lambda placed: beam_clearance(tracker, placed.smr, placed, own=True) - BEAM_RADIUS,
        OWN_BODIES: lambda placed: self_clearance(placed, cell.self_clearance) - cell.self_clearance,
    }
    if arm.mounted:
        margins[MOUNTED] = lambda placed: np.where(mounted_hides(tracker, placed, BEAM_RADIUS), -np.inf, np.inf)
    for obstacle, asked in zip(cell.obstacles, cell.obstacle_clearances[arm], strict=True):
        margins[f"obstacle '{obstacle.name}' in the beam"] = partial(_beam_margin, obstacle, tracker)
        if np.any(asked > -np.inf):
            margins[f"obstacle '{obstacle.name}'"] = partial(_obstacle_margin, obstacle, asked)
    return margins


def _beam_margin(obstacle: ObstacleBody, tracker: Array, placed: Placed) -> Array:
    return beam_gaps((obstacle,), tracker, placed.smr, BEAM_RADIUS) - BEAM_RADIUS


def _obstacle_margin(obstacle: ObstacleBody, asked: Array, placed: Placed) -> Array:
    bodies = np.flatnonzero(asked > -np.inf)
    gaps = obstacle.gaps(placed.start[:, bodies], placed.end[:, bodies], placed.radius[bodies], asked[bodies])
    return np.asarray((gaps - asked[bodies]).min(axis=1))


# -- Constraints that exclude configurations of an arm from being measured: how many, by how much, and what helps -----


_EXAMINED = 36_000
"""Number of configurations examined: shares to a tenth of a percent in a fifth of a second."""
_SEED = 0
"""Seed of these configurations: always the same, so that the shares of two cells can be compared."""
_TURN = 2.0 * math.pi
_SUBJECTS: Mapping[str, str] = {
    RANGE: "tracker.distance",
    AZIMUTH: "tracker.azimuth",
    ELEVATION: "tracker.elevation",
    FACING: "the SMR's viewing direction (smr.normal, smr.acceptance)",
    FLOOR: "the floor (plan.floor, plan.clearance)",
    CEILING: "the ceiling (plan.ceiling, plan.clearance)",
    OWN_BEAM: "the arm's own body in the beam",
    OWN_BODIES: "the arm's clearance from itself",
    MOUNTED: "what is mounted beside the SMR",
}
_ADVICE: Mapping[str, str] = {
    RANGE: "move the tracker (tracker.pose), or check tracker.distance",
    AZIMUTH: "turn the tracker about its vertical axis (tracker.pose), or check tracker.azimuth",
    ELEVATION: "raise or lower the tracker, or move it farther away (tracker.pose), or check tracker.elevation",
    FACING: "turn smr.normal or the base towards the tracker, widen arms.*.limits or plan.ranges, or use an SMR of"
    " wider acceptance",
    FLOOR: "check plan.floor and arms.*.base, or ask for a smaller plan.clearance",
    CEILING: "check plan.ceiling and arms.*.base, or ask for a smaller plan.clearance",
    OWN_BEAM: "move the tracker, or fix the SMR farther from the arm's axes (smr.offset)",
    OWN_BODIES: "check arms.*.limits, plan.ranges and the capsules of the arm's type",
    MOUNTED: "mount it behind the SMR, or turn smr.normal away from it",
}


def shortage(cell: CellBodies, profile: Profile, name: str, found: int, sampled: int) -> str:
    """Compose one message: how few configurations of an arm are usable, which constraint excludes most, what helps.

    The first constraint is the one without which most configurations could be measured.
    """
    arm, field, (low, high) = cell.arms[name], _field(cell, name), joint_ranges(cell, profile, name).T
    placed = place(arm, np.random.default_rng(_SEED).uniform(low, high, size=(_EXAMINED, len(low))))
    sight = sight_of(field.T_C_M, placed)
    examined = _sight_examined(field, sight, arm.acceptance)
    for constraint, margin in body_margins(cell, field, name).items():
        metres = margin(placed)
        examined.append(_Examined(constraint, ~(metres > 0.0), -1e3 * metres, "mm"))
    failed = np.sum([one.fails for one in examined], axis=0)
    shares = [(float((failed == one.fails).mean()), float(one.fails.mean())) for one in examined]
    first, second = sorted(range(len(examined)), key=shares.__getitem__, reverse=True)[:2]
    (without, alone), worst = shares[first], examined[first]
    decisive = worst.fails & (failed == 1)
    extent = _extent(field, worst, sight, decisive if decisive.any() else worst.fails)
    subject, next_one = (_SUBJECTS.get(examined[k].name, examined[k].name) for k in (first, second))
    advice = _ADVICE.get(worst.name, f"move the {worst.name.removesuffix(' in the beam')} or the tracker")
    asked = f", {profile.plan.stops + profile.plan.reserve} are needed" if found else ""
    if without > 0.0:
        besides = f"Without it {_percent(without)} could be measured."
    else:
        besides = f"No other constraint decides alone; next, {next_one} excludes {_percent(shares[second][1])}."
    return (
        f"plan: arm {name}: {found or 'none'} of {sampled} random configurations can be measured{asked}. Most are"
        f" excluded by {subject} ({_percent(alone)}): {extent}. {besides} What helps: {advice}"
    )


@dataclass(frozen=True, eq=False)
class _Examined:
    """One constraint at n configurations: where it fails (n,), and by how much it is missed (n,) in ``unit``."""

    name: str
    fails: NDArray[np.bool_]
    missed: Array
    unit: str


def _sight_examined(field: TrackerField, sight: Sight, acceptance: float) -> list[_Examined]:
    """Examine the conditions on the SMRs, and by how much they are missed in mm or deg."""
    low, high = field.distance
    lowest, highest = field.elevation
    past_side = np.mod(sight.azimuth - field.azimuth[0], _TURN)
    width = field.azimuth[1] - field.azimuth[0]
    elevation = np.arcsin(np.clip(sight.sine_of_elevation, -1.0, 1.0))
    missed = {
        RANGE: (1e3 * np.maximum(low - sight.distance, sight.distance - high), "mm"),
        AZIMUTH: (np.degrees(np.minimum(past_side - width, _TURN - past_side)), "deg"),
        ELEVATION: (np.degrees(np.maximum(lowest - elevation, elevation - highest)), "deg"),
        FACING: (np.degrees(sight.incidence - usable_acceptance(acceptance)), "deg"),
    }
    return [_Examined(name, ~holds, *missed[name]) for name, holds in sight_conditions(field, acceptance, sight)]


def _extent(field: TrackerField, one: _Examined, sight: Sight, rows: NDArray[np.bool_]) -> str:
    """Describe what is seen at ``rows`` against what is allowed, and by how much the nearest of them misses."""
    if not rows.any():
        return "it excludes none"
    by = _by_how_much(one, rows)
    if one.name == RANGE:
        seen, allowed = sight.distance[rows], np.array(field.distance)
        return f"the SMR is {_span(seen, '.2f')} m from the tracker, allowed are {_span(allowed, '.4g')} m; {by}"
    if one.name in (AZIMUTH, ELEVATION):
        seen = sight.azimuth[rows] if one.name == AZIMUTH else np.arcsin(sight.sine_of_elevation[rows])
        middle = np.angle(np.exp(1j * seen).mean())  # azimuths may cross the cut at half a turn
        seen = np.degrees(middle + np.angle(np.exp(1j * (seen - middle))))
        allowed = np.degrees(field.azimuth if one.name == AZIMUTH else field.elevation)
        return f"the SMR is seen at {_span(seen, '.0f')} deg, allowed are {_span(allowed, '.4g')} deg; {by}"
    if one.name == FACING:
        return f"the SMR looks away from the tracker; {by}"
    return by


def _by_how_much(one: _Examined, rows: NDArray[np.bool_]) -> str:
    """Say by how much the nearest of ``rows`` misses; if other rows hold, by how much half of them miss."""
    nearest, half = float(np.min(one.missed[rows])), float(np.median(one.missed[rows]))
    if not math.isfinite(nearest):
        return "it hides the SMR"
    if one.fails.all():
        return f"the nearest misses by {nearest:.0f} {one.unit}"
    return f"half miss by {half:.0f} {one.unit} or more"


def _span(values: Array, number_format: str) -> str:
    return f"{np.min(values):{number_format}} to {np.max(values):{number_format}}"


def _percent(share: float) -> str:
    """Format a share of the configurations in percent, never rounded to all or nothing."""
    if share in (0.0, 1.0):
        return "all of them" if share else "none"
    return f"{100.0 * share:.{1 if 0.01 < share < 0.99 else 2}f} % of them"


# -- Configurations that represent the workspace: where targets will be, whichever way the SMR faces ------------------


_MOST_BATCHES = 50
"""Number of batches after which sampling ends where hardly any configuration is clear."""


def workspace_configurations(
    profile: Profile, cell: CellBodies, name: str, count: int, rng: np.random.Generator
) -> Array:
    """Sample ``count`` configurations (count, N) [rad], uniform in the plan's joint ranges where the arm is clear.

    The tracker need not see them: targets are work, not measurements. Fewer where hardly any is clear.
    """
    low, high = joint_ranges(cell, profile, name).T
    found: list[Array] = []
    for _ in range(_MOST_BATCHES):
        q = rng.uniform(low, high, size=(4 * count, len(low)))
        found.append(q[clear_alone(cell, place(cell.arms[name], q))])
        if sum(map(len, found)) >= count:
            break
    return np.concatenate(found)[:count]
