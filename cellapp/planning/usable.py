"""Which configurations of one arm can be measured: one condition after the other, the cheap and telling ones first."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.kinematics.transforms import Array
from cellapp.planning.joint_draws import JointDraws
from cellapp.safety.bodies import (
    Placed,
    beam_clearance,
    ceiling_clearance,
    floor_clearance,
    place,
    self_clearance,
)
from cellapp.safety.gate import CellBodies, TrackerField, clear_alone, visible
from cellapp.safety.visibility import BEAM_RADIUS, sight_conditions

INCIDENCE = "incidence"
"""Name under which configurations are counted that could be measured, but are left out to prefer others."""
GATE = "gate"
"""Name under which configurations are counted that all named conditions admit and the safety gate does not."""


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
    """The usable configurations among ``draws``; ``keep`` says which to keep by their incidence (n,) [rad]."""
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
        clear = margin(placed) > 0.0
        rejected[constraint] = len(rows) - int(np.count_nonzero(clear))
        rows, placed = rows[clear], placed.take(clear)
    admitted = visible(cell, name, q[rows]) & clear_alone(cell, placed)
    rejected[GATE] = len(rows) - int(np.count_nonzero(admitted))
    rows = rows[admitted]
    return Usable(seen.size, q[rows], smr_M[rows], incidence[rows], rejected)


def body_margins(cell: CellBodies, field: TrackerField, name: str) -> Mapping[str, Callable[[Placed], Array]]:
    """Constraint -> how far an arm is from offending it [m] at n configurations, shape (n,); negative where it does."""
    tracker = field.T_C_M[:3, 3]
    margins: dict[str, Callable[[Placed], Array]] = {
        "floor": lambda placed: floor_clearance(placed, cell.floor) - cell.clearance,
        "ceiling": lambda placed: ceiling_clearance(placed, cell.ceiling) - cell.clearance,
        "own arm in the beam": lambda placed: beam_clearance(tracker, placed.smr, placed, own=True) - BEAM_RADIUS,
        "own bodies": lambda placed: self_clearance(placed) - 0.01,
    }
    return margins
