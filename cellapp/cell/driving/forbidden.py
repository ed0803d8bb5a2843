"""Joint positions that the arms' controllers forbid, queried before anything moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.driving.cell import Cell
from cellapp.cell.driving.together import answers_of_all
from cellapp.cell.driving.work import Work
from cellapp.ground.errors import HardwareError
from drivers.arms.protocol import ArmError

Vector = NDArray[np.float64]


def forbidden_stops(cell: Cell, work: Work, homes: Mapping[str, Vector]) -> tuple[dict[int, str], dict[str, ArmError]]:
    """Return the stops that a controller forbids, stop -> reason, and errors by arm.

    The query covers all stops that are not stored, and the reserves, with the ends of their legs and the starts of
    their last motions. All controllers are queried concurrently: each needs some milliseconds per position.

    Raises
    ------
    HardwareError
        If a controller forbids a home position.
    """
    stops = [*work.stops, *work.reserves]
    asked = {name: _positions(work, stops, name) for name in cell.arms}
    calls = {
        name: partial(arm.refused_by_controller, np.vstack([homes[name], *(q for _, q in asked[name])]))
        for name, arm in cell.arms.items()
    }
    answers, errors = answers_of_all(cell.together, calls)
    forbidden: dict[int, str] = {}
    for name, refused in answers.items():
        if refused[0]:
            raise HardwareError(
                f"arm {name}: the controller's safety limits forbid its home position; change arms.{name}.home, or"
                " the safety limits on the pendant"
            )
        for row in np.flatnonzero(refused[1:]):
            stop = asked[name][row][0]
            forbidden.setdefault(stop, f"arm {name}: the controller's safety limits forbid these joint positions")
    return forbidden, errors


def _positions(work: Work, stops: Sequence[int], name: str) -> list[tuple[int, Vector]]:
    """Return the joint positions of an arm at stops and on the planned ways to them, each with its stop."""
    found = []
    for stop in stops:
        way = [*work.route.legs[stop], work.route.approach_starts(stop), work.targets(stop)]
        found += [(stop, motion[name]) for motion in way if name in motion]
    return found
