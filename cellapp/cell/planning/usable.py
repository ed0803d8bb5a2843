"""Selection of the configurations of one arm that can be measured: cheap and selective conditions come first."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.joint_draws import JointDraws
from cellapp.cell.safety.bodies import (
    Placed,
    beam_clearance,
    ceiling_clearance,
    floor_clearance,
    mounted_hides,
    place,
    self_clearance,
)
from cellapp.cell.safety.gate import BEAM_RADIUS, CellBodies, clear_alone, visible
from cellapp.cell.safety.obstacles import Obstacle, beam_gaps
from cellapp.cell.safety.visibility import TrackerField, sight_conditions
from cellapp.robot.kinematics.transforms import Array

FLOOR, CEILING, OWN_BODIES = "floor", "ceiling", "own bodies"
OWN_BEAM, MOUNTED = "own arm in the beam", "mounted obstacle in the beam"
"""Constraints that bodies set; each obstacle adds two more, under its name."""
INCIDENCE = "incidence"
"""Name under which measurable configurations are counted that are left out to prefer smaller angles of incidence."""
GATE = "gate"
"""Name under which configurations are counted that all named constraints admit but the safety gate refuses."""


@dataclass(frozen=True, eq=False)
class Usable:
    """Of the configurations of a draw, n that the tracker sees and at which the arm is clear.

    Attributes
    ----------
    drawn : int
        Configurations of the draw.
    q : array, shape (n, N)
        Joint positions [rad].
    smr_M : array, shape (n, 3)
        SMR centres in the tracker frame M [m].
    incidence : array, shape (n,)
        [rad]
    rejected : mapping
        Constraint -> how many it excluded; each configuration counts for the first that does, in the order given.
    """

    drawn: int
    q: Array
    smr_M: Array
    incidence: Array
    rejected: Mapping[str, int]


def usable(
    cell: CellBodies,
    field: TrackerField,
    name: str,
    draws: JointDraws,
    keep: Callable[[Array], NDArray[np.bool_]] | None = None,
) -> Usable:
    """Select the usable configurations among ``draws``; ``keep`` decides by incidence (n,) [rad] what to keep."""
    rejected: dict[str, int] = {}
    seen = np.ones(draws.sight.distance.shape, dtype=bool)
    count = seen.size
    for constraint, holds in sight_conditions(field, cell.arms[name].acceptance, draws.sight):
        seen &= holds
        left = int(np.count_nonzero(seen))
        rejected[constraint], count = count - left, left
    q, smr_M = draws.q(seen), draws.sight.smr_M[:, seen].T
    incidence = np.arccos(np.minimum(draws.sight.cosine[seen], 1.0))
    rows = np.arange(len(q))
    if keep is not None:
        rows = rows[keep(incidence)]
        rejected[INCIDENCE] = len(q) - len(rows)
    placed = place(cell.arms[name], q[rows])
    for constraint, margin in body_margins(cell, field, name).items():
        clear = margin(placed) > 0.0  # not for NaN
        rejected[constraint] = len(rows) - int(np.count_nonzero(clear))
        rows, placed = rows[clear], placed.take(clear)
    return Usable(seen.size, q[rows], smr_M[rows], incidence[rows], rejected)


def together(batches: Sequence[Usable]) -> Usable:
    """Merge the configurations of several draws into one."""
    q, smr_M, incidence = (
        np.concatenate([getattr(batch, part) for batch in batches]) for part in ("q", "smr_M", "incidence")
    )
    rejected = {constraint: sum(batch.rejected[constraint] for batch in batches) for constraint in batches[0].rejected}
    return Usable(sum(batch.drawn for batch in batches), q, smr_M, incidence, rejected)


def admitted_by_gate(cell: CellBodies, name: str, found: Usable) -> Usable:
    """Select the configurations that the safety gate, too, finds visible and clear: its answer is final."""
    admitted = visible(cell, name, found.q) & clear_alone(cell, place(cell.arms[name], found.q))
    rejected = {**found.rejected, GATE: len(admitted) - int(np.count_nonzero(admitted))}
    return Usable(found.drawn, found.q[admitted], found.smr_M[admitted], found.incidence[admitted], rejected)


def body_margins(cell: CellBodies, field: TrackerField, name: str) -> Mapping[str, Callable[[Placed], Array]]:
    """Map each constraint to the margin of an arm [m] at n configurations, shape (n,); negative where it is violated.

    Infinite where there is no distance: without bodies, and for what is mounted beside the SMR.
    """
    tracker, arm = field.T_C_M[:3, 3], cell.arms[name]
    margins: dict[str, Callable[[Placed], Array]] = {
        FLOOR: lambda placed: floor_clearance(placed, cell.floor) - cell.clearance,
        CEILING: lambda placed: ceiling_clearance(placed, cell.ceiling) - cell.clearance,
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


def _beam_margin(obstacle: Obstacle, tracker: Array, placed: Placed) -> Array:
    return beam_gaps((obstacle,), tracker, placed.smr, BEAM_RADIUS) - BEAM_RADIUS


def _obstacle_margin(obstacle: Obstacle, asked: Array, placed: Placed) -> Array:
    bodies = np.flatnonzero(asked > -np.inf)
    gaps = obstacle.gaps(placed.start[:, bodies], placed.end[:, bodies], placed.radius[bodies], asked[bodies])
    return np.asarray((gaps - asked[bodies]).min(axis=1))
