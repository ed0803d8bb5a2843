"""The pool of candidates: configurations of one arm that the tracker sees and at which the arm is clear."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.planning.joint_draws import JointDraws, draw_joints
from cellapp.planning.plan import joint_ranges
from cellapp.profile import Profile
from cellapp.progress import CancelToken
from cellapp.safety.bodies import place
from cellapp.safety.gate import CellBodies, TrackerField, clear_alone, visible

Mask = NDArray[np.bool_]
_OBLIQUE_WEIGHT = 0.25
"""Share that is kept of the configurations beyond the incidence of full accuracy: they tell the same of the arm with a
worse measurement, but effects of the incidence need some."""
_MOST_DRAWS = 1_000_000
_MOST_DRAWS_PER_CANDIDATE = 400
"""Draws after which the search ends: three times what a candidate takes in the twin cell, some seconds."""


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
    """``count`` candidates of an arm, fewer where they are rare.

    Each is uniform in the joint space of the plan, restricted to configurations that are visible and clear; of those
    with an incidence above ``plan.incidence`` a quarter is kept.

    Raises
    ------
    InputError
        If fewer are found than the plan has stops.
    Cancelled
    """
    cancel = cancel or CancelToken()
    if cell.field is None:
        raise InputError(f"plan: arm {name}: the cell has no tracker; give tracker.pose")
    arm, ranges = cell.arms[name], joint_ranges(cell, profile, name)
    rejected: dict[str, int] = {}
    found: list[Array] = []
    incidences: list[Array] = []
    drawn = 0
    least = min(count, profile.plan.stops + profile.plan.reserve)
    while sum(map(len, found)) < count and drawn < max(_MOST_DRAWS, count * _MOST_DRAWS_PER_CANDIDATE):
        cancel.check()
        draws = draw_joints(arm, cell.field.T_C_M, ranges, rng)
        drawn += draws.cosine.size
        q, incidence = _seen(cell.field, arm.acceptance, draws, rejected)
        kept = (incidence <= profile.plan.incidence) | (rng.random(len(q)) < _OBLIQUE_WEIGHT)
        q, incidence = _kept(q, incidence, kept, "incidence", rejected)
        q, incidence = _kept(q, incidence, visible(cell, name, q), "beam", rejected)
        q, incidence = _kept(q, incidence, clear_alone(cell, place(arm, q)), "bodies", rejected)
        found.append(q)
        incidences.append(incidence)
    if sum(map(len, found)) < least:
        counts = ", ".join(f"{constraint} {number}" for constraint, number in rejected.items() if number)
        raise InputError(
            f"plan: arm {name}: only {sum(map(len, found))} of {least} usable configurations in {drawn} draws; excluded"
            f" by {counts}"
        )
    return CandidatePool(np.concatenate(found)[:count], np.concatenate(incidences)[:count], drawn, rejected)


def _seen(field: TrackerField, acceptance: float, draws: JointDraws, rejected: dict[str, int]) -> tuple[Array, Array]:
    """Configurations (n, N) [rad] in the tracker's field of view that face it, and their incidence (n,) [rad]."""
    ok = np.ones(draws.cosine.shape, dtype=bool)
    for constraint, mask in _sight_constraints(field, acceptance, draws):
        before = int(ok.sum())
        ok &= mask
        rejected[constraint] = rejected.get(constraint, 0) + before - int(ok.sum())
    return draws.q(ok), np.arccos(np.minimum(draws.cosine[ok], 1.0))


def _sight_constraints(field: TrackerField, acceptance: float, draws: JointDraws) -> list[tuple[str, Mask]]:
    low, high = field.distance
    left, right = field.azimuth
    span = [math.sin(angle) for angle in field.elevation]
    z = draws.smr_M[2]
    azimuth = np.arctan2(draws.smr_M[1], draws.smr_M[0])
    return [
        ("range", (draws.distance >= low) & (draws.distance <= high)),
        ("azimuth", np.mod(azimuth - left, 2.0 * math.pi) <= right - left),
        ("elevation", (z >= span[0] * draws.distance) & (z <= span[1] * draws.distance)),
        ("facing", draws.cosine > math.cos(max(0.0, acceptance - math.radians(3.0)))),
    ]


def _kept(
    q: Array, incidence: Array, ok: NDArray[np.bool_], constraint: str, rejected: dict[str, int]
) -> tuple[Array, Array]:
    rejected[constraint] = rejected.get(constraint, 0) + len(q) - int(ok.sum())
    return q[ok], incidence[ok]
