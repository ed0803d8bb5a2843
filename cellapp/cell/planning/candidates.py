"""The pool of candidates: configurations of one arm that the tracker sees and at which the arm is clear."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.exclusions import shortage
from cellapp.cell.planning.joint_draws import draw_joints, joint_ranges
from cellapp.cell.planning.usable import Usable, admitted_by_gate, together, usable
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.gate import CellBodies, clear_alone, in_view, visible
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken
from cellapp.robot.kinematics.transforms import Array

_OBLIQUE_SHARE = 0.25
"""Share of the configurations beyond the incidence of full accuracy that is kept: they are measured worse, but without
them effects of the incidence could not be seen."""
_INDEPENDENT = 4000
"""Independent configurations drawn at once: about 60 of them are usable in the twin cell, and they fit in the cache."""
_ASKED_AT_ONCE = 1000
"""Number of configurations that the safety gate is asked about at once."""
_MOST_DRAWS = 800_000
_MOST_DRAWS_PER_CANDIDATE = 400
"""Draws after which the search ends: four times the number that a candidate takes in the twin cell, some seconds."""


@dataclass(frozen=True, eq=False)
class CandidatePool:
    """m configurations of one arm, each visible and clear without regard to other arms.

    Attributes
    ----------
    q : array, shape (m, N)
        Joint positions [rad].
    incidence : array, shape (m,)
        Angle between beam and viewing direction of the SMR [rad].
    drawn : int
        Configurations drawn to find them.
    rejected : mapping
        Constraint -> how many of those drawn it excluded. A configuration counts for the first that excludes it, in
        the order of the mapping.
    """

    q: Array
    incidence: Array
    drawn: int
    rejected: Mapping[str, int]


def draw_pool(
    cell: CellBodies,
    profile: Profile,
    name: str,
    count: int,
    rng: np.random.Generator,
    cancel: CancelToken | None = None,
) -> CandidatePool:
    """Draw ``count`` candidates of an arm in random order, fewer where they are rare.

    Each is uniform in the joint ranges of the plan, restricted to configurations that are visible and clear; of those
    with an incidence above ``plan.incidence`` a quarter is kept. About half of them have their first joints, or their
    wrist, in common with one or a few others; no two are equal.

    Raises
    ------
    InputError
        If fewer are found than the plan has stops; the message says which constraint excludes them.
    Cancelled
    """

    def keep(incidence: Array) -> NDArray[np.bool_]:
        lucky = rng.random(len(incidence)) < _OBLIQUE_SHARE
        return np.asarray(lucky | (incidence <= profile.plan.incidence))

    if cell.field is None:
        raise InputError(f"plan: arm {name}: the cell has no tracker that could see its SMR; give tracker.pose")
    cancel, ranges = cancel or CancelToken(), joint_ranges(cell, profile, name)
    found: list[Usable] = []
    drawn = number = 0
    most = max(_MOST_DRAWS, count * _MOST_DRAWS_PER_CANDIDATE)
    while number < count and drawn < most:
        asked: list[Usable] = []
        while drawn < most and sum(len(batch.q) for batch in asked) < min(count - number, _ASKED_AT_ONCE):
            cancel.check()
            draws = draw_joints(cell.arms[name], cell.field.T_C_M, ranges, rng)
            asked.append(usable(cell, cell.field, name, draws, keep))
            drawn += asked[-1].drawn
        found.append(admitted_by_gate(cell, name, together(asked)))
        number += len(found[-1].q)
    if number < min(count, profile.plan.stops + profile.plan.reserve):
        raise InputError(shortage(cell, profile, name, number, drawn))
    pool = together(found)
    order = rng.permutation(number)[:count]
    return CandidatePool(pool.q[order], pool.incidence[order], drawn, pool.rejected)


def random_configurations(cell: CellBodies, profile: Profile, name: str, rng: np.random.Generator) -> Iterator[Array]:
    """Yield usable configurations (N,) [rad] of an arm without end, independent and uniform in the plan's joint ranges.

    Raises
    ------
    InputError
        If none is found in many draws; the message says which constraint excludes them.
    """
    low, high = joint_ranges(cell, profile, name).T
    arm, none = cell.arms[name], np.arange(0)
    bare = replace(arm, frames=arm.frames[none], start=arm.start[none], end=arm.end[none], radius=arm.radius[none])
    fruitless = 0
    while True:
        q = rng.uniform(low, high, size=(_INDEPENDENT, len(low)))
        if cell.field is not None:  # most face away from the tracker: that is checked without bodies
            q = q[in_view(cell.field, place(bare, q))]
        q = q[visible(cell, name, q)]
        q = q[clear_alone(cell, place(arm, q))]
        yield from q[::-1]  # this order belongs to the seed: a profile gives the same plan each time
        fruitless = 0 if len(q) else fruitless + _INDEPENDENT
        if fruitless >= _MOST_DRAWS:
            raise InputError(shortage(cell, profile, name, 0, fruitless))
