"""Further SMRs on a flange: which of them the tracker sees at a stop, and the shortest order to measure them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import permutations
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.gate import CellBodies, predicted_smr, visible
from cellapp.ground.counting import counted
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array

_MOST_IN_ALL_ORDERS = 6
"""Largest number of nests for which all orders are compared; more are measured in the profile's order."""


@dataclass(frozen=True)
class Nests:
    """Nests of known offset of each arm, as cells in which the arm's SMR is in that nest.

    Attributes
    ----------
    names : mapping
        Arm with nests -> name of its SMR.
    cell : CellBodies
        Cell with each arm's SMR as in the profile.
    cells : mapping
        Arm -> nest -> cell.
    """

    names: Mapping[str, str]
    cell: CellBodies
    cells: Mapping[str, Mapping[str, CellBodies]]

    @classmethod
    def of(
        cls, profile: Profile, cell: CellBodies, found: Mapping[str, Mapping[str, Array]] = MappingProxyType({})
    ) -> Nests:
        """Return the nests of a profile, without those of unknown offset, where the tracker cannot be pointed.

        Offsets ``found``, arm -> nest -> (3,) [m] in F, take precedence over the profile's.
        """
        names, cells = {}, {}
        for name, arm in profile.arms.items():
            if not arm.smr.nests:
                continue
            names[name] = arm.smr.name
            stated = {nest: np.array(its.offset) for nest, its in arm.smr.nests.items() if its.offset != "unknown"}
            offsets = {nest: own for nest, own in {**stated, **found.get(name, {})}.items() if nest != arm.smr.name}
            cells[name] = {nest: _with_smr_at(cell, name, offset_F) for nest, offset_F in offsets.items()}
        return cls(names, cell, cells)

    def seen(self, name: str, q: Mapping[str, Array]) -> dict[str, NDArray[np.bool_]]:
        """Return whether the tracker sees each nest of an arm at n stops; ``q`` maps all arms to (n, N) [rad]."""
        others = {other: rows for other, rows in q.items() if other != name}
        return {nest: visible(cell, name, q[name], others) for nest, cell in self.cells.get(name, {}).items()}

    def in_order(self, name: str, q: Mapping[str, Array]) -> list[tuple[str, Array]]:
        """Return an arm's visible nests at one stop (arm -> (N,) [rad]) with their expected positions (3,) [m].

        The order minimises the rotation of the beam, starting from the arm's SMR, which is measured first.
        """
        at = {other: rows[None] for other, rows in q.items()}
        seen = [nest for nest, visible_there in self.seen(name, at).items() if visible_there[0]]
        places = {nest: predicted_smr(self.cells[name][nest], name, at[name])[0] for nest in seen}
        if not seen or len(seen) > _MOST_IN_ALL_ORDERS:
            return list(places.items())
        start = predicted_smr(self.cell, name, at[name])[0]
        order = min(permutations(seen), key=lambda one: _way(start, [places[nest] for nest in one]))
        return [(nest, places[nest]) for nest in order]

    def notes(self, q: Mapping[str, Array]) -> list[str]:
        """Report for n stops (arm -> (n, N) [rad]) at how many the tracker sees each nest, and an orientation."""
        found = []
        for name, own in self.names.items():
            seen = self.seen(name, q)
            if not seen:
                found.append(f"arm {name}: no offset of a further nest is known; none can be measured, only imported")
                continue
            n = len(q[name])
            together = int(np.count_nonzero(np.sum(list(seen.values()), axis=0) >= 2))
            each = ", ".join(f"{nest} at {int(np.count_nonzero(rows))}" for nest, rows in seen.items())
            found.append(
                f"arm {name}: beside nest {own} the tracker sees {each} of {counted(n, 'stop')}; orientation follows at"
                f" {together}"
            )
        return found


def _with_smr_at(cell: CellBodies, name: str, offset_F: Array) -> CellBodies:
    arm = cell.arms[name]
    moved = replace(arm, geometry=replace(arm.geometry, tool=offset_F))
    return replace(cell, arms={**cell.arms, name: moved})


def _way(start: Array, places: list[Array]) -> float:
    """Return the angle [rad] that the beam turns from a point (3,) through others in order."""
    beams = np.array([start, *places])
    beams = beams / np.linalg.norm(beams, axis=1, keepdims=True)
    return float(np.arccos(np.clip(np.sum(beams[1:] * beams[:-1], axis=1), -1.0, 1.0)).sum())
