"""The pool of candidates: configurations of one arm that the tracker sees and at which the arm is clear."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.planning.exclusions import shortage
from cellapp.planning.joint_draws import GROUP, draw_joints, joint_ranges
from cellapp.planning.usable import Usable, admitted_by_gate, usable
from cellapp.profile import Profile
from cellapp.progress import CancelToken
from cellapp.safety.gate import CellBodies

_OBLIQUE_SHARE = 0.25
"""Share that is kept of the configurations beyond the incidence of full accuracy: they tell the same of the arm with a
worse measurement, but effects of the incidence need some."""
_MOST_DRAWS = 800_000
_MOST_DRAWS_PER_CANDIDATE = 400
"""Draws after which the search ends: four times what a candidate takes in the twin cell, some seconds."""


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
    """``count`` candidates of an arm in random order, fewer where they are rare.

    Each is uniform in the joint ranges of the plan, restricted to configurations that are visible and clear; of those
    with an incidence above ``plan.incidence`` a quarter is kept. About half of them have their first joints, or
    their wrist, in common with one or a few others; no two are equal.

    Raises
    ------
    InputError
        If fewer are found than the plan has stops; the message says which constraint excludes them.
    Cancelled
    """

    def keep(incidence: Array) -> NDArray[np.bool_]:
        lucky = rng.random(len(incidence)) < _OBLIQUE_SHARE
        return np.asarray(lucky | (incidence <= profile.plan.incidence))

    cancel = cancel or CancelToken()
    found: list[Usable] = []
    drawn = number = 0
    for batch in _usable_draws(cell, profile, name, rng, keep=keep):
        cancel.check()
        found.append(batch)
        drawn, number = drawn + batch.drawn, number + len(batch.q)
        if number >= count or drawn >= max(_MOST_DRAWS, count * _MOST_DRAWS_PER_CANDIDATE):
            break
    if number < min(count, profile.plan.stops + profile.plan.reserve):
        raise InputError(shortage(cell, profile, name, number, drawn))
    rejected = sum((Counter(batch.rejected) for batch in found), Counter())
    order = rng.permutation(number)[:count]
    return CandidatePool(
        q=np.concatenate([batch.q for batch in found])[order],
        incidence=np.concatenate([batch.incidence for batch in found])[order],
        drawn=drawn,
        rejected={constraint: rejected[constraint] for constraint in found[0].rejected},
    )


def random_configurations(cell: CellBodies, profile: Profile, name: str, rng: np.random.Generator) -> Iterator[Array]:
    """Usable configurations (N,) [rad] of an arm without end, independent and uniform in the joint ranges of the plan.

    Raises
    ------
    InputError
        If none is found in many draws; the message says which constraint excludes them.
    """
    fruitless = 0
    for batch in _usable_draws(cell, profile, name, rng, group=1):
        yield from batch.q
        fruitless = 0 if len(batch.q) else fruitless + batch.drawn
        if fruitless >= _MOST_DRAWS:
            raise InputError(shortage(cell, profile, name, 0, fruitless))


def _usable_draws(
    cell: CellBodies,
    profile: Profile,
    name: str,
    rng: np.random.Generator,
    *,
    group: int = GROUP,
    keep: Callable[[Array], NDArray[np.bool_]] | None = None,
) -> Iterator[Usable]:
    """Usable configurations, draw by draw, without end."""
    if cell.field is None:
        raise InputError(f"plan: arm {name}: the cell has no tracker that could see its SMR; give tracker.pose")
    ranges = joint_ranges(cell, profile, name)
    while True:
        draws = draw_joints(cell.arms[name], cell.field.T_C_M, ranges, rng, group)
        yield admitted_by_gate(cell, name, usable(cell, cell.field, name, draws, keep))
