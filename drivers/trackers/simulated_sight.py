"""The view of the simulated tracker: SMRs of arms and nests, and the bodies between them and the tracker."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.plant import Plant
from drivers.plant.clearance import segment_distances
from drivers.plant.mechanism import Posture, nominal
from drivers.plant.optics import why_hidden
from drivers.plant.recent import recent_smr
from drivers.plant.transforms import transform_points

Vector = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Smr:
    """An SMR: its owner in words, its arm (None for a nest), position (3,) [m] in M, why it is hidden ("" if visible).

    ``R_M_S`` and ``sigma_rad`` are those of ``Target``.
    """

    owner: str
    arm: str | None
    p_M: Vector
    hidden: str
    moving: bool = False
    R_M_S: Vector | None = None
    sigma_rad: float = 0.0


class Sight:
    """The view of a tracker of ``plant``.

    Attributes
    ----------
    covered : set of str
        Arms or nests whose SMR is covered.
    """

    def __init__(self, plant: Plant, nests: Mapping[str, Vector] | None) -> None:
        """``nests`` are SMRs at fixed places, name -> (3,) [m] in M."""
        self._plant = plant
        self._nests = {name: np.array(p, dtype=np.float64) for name, p in (nests or {}).items()}
        self._bodies = {arm.name: nominal(arm) for arm in plant.config.arms}
        self._placed: dict[str, tuple[bytes, tuple[Vector, Vector]]] = {}
        """Cache: arm -> joint positions, and the ends of its capsules there."""
        self.covered: set[str] = set()

    def targets(self) -> list[Smr]:
        """Return all SMRs of arms and nests, ignoring bodies in the beam."""
        found = []
        for target in self._plant.targets():
            why = self._cover(target.arm) or target.hidden
            probe = (target.R_M_S, target.sigma_rad)
            found.append(Smr(f"arm {target.arm}", target.arm, target.p_M, why, target.moving, *probe))
        for name, p_M in self._nests.items():
            facing = -p_M / np.linalg.norm(p_M)
            why = self._cover(name) or why_hidden(self._plant.config.tracker, p_M, facing, math.pi)
            found.append(Smr(f"nest {name}", None, p_M, why))
        return found

    def _cover(self, name: str) -> str:
        """Return why the SMR of an arm or nest is covered; empty if it is not."""
        return "something covers it" if name in self.covered else ""

    def behind_bodies(self, target: Smr) -> Smr:
        """Return the SMR, hidden if a body is in the beam."""
        why = target.hidden or self._beam_obstacle(target.p_M, target.arm)
        return replace(target, hidden=why)

    def _beam_obstacle(self, p_M: Vector, owner: str | None) -> str:
        """Return in words whose body is between the tracker and ``p_M``; empty if there is none.

        Bodies fixed to the owner's flange are not checked: they hold the SMR, where the beam ends.
        """
        owners: list[str] = []
        bodies: list[tuple[Vector, Vector, Vector]] = []
        for name, mechanism in self._bodies.items():
            capsules = mechanism.capsules
            counted = capsules.frames < len(mechanism.masses) if name == owner else np.ones(len(capsules.frames), bool)
            start, end = self._segments(name)
            owners += [name] * int(counted.sum())
            bodies.append((start[counted], end[counted], capsules.radii[counted]))
        if not bodies:
            return ""
        start, end, radii = (np.concatenate(part) for part in zip(*bodies, strict=True))
        gaps = segment_distances(np.zeros_like(start), np.broadcast_to(p_M, start.shape), start, end)
        for row in np.flatnonzero(gaps < radii)[:1]:
            return f"{'its own arm' if owners[row] == owner else f'arm {owners[row]}'} blocks the beam"
        return ""

    def _segments(self, name: str) -> tuple[Vector, Vector]:
        """Return the ends (k, 3) of an arm's capsules in M, cached while the arm rests."""
        q = self._plant.q(name)
        key = q.tobytes()
        if name not in self._placed or self._placed[name][0] != key:
            posture = Posture(self._bodies[name], q[None], np.zeros(3))
            T_M_B = self._plant.true_T_M_B(name)
            start, end = (transform_points(T_M_B, ends[:, 0]) for ends in posture.segments())
            self._placed[name] = (key, (start, end))
        return self._placed[name][1]

    def recent(self, locked: Smr, time_s: Vector) -> tuple[Vector, Vector]:
        """Return positions and viewing directions (n, 3) of an SMR at recent times (n,)."""
        if locked.arm is not None:
            return recent_smr(self._plant, locked.arm, time_s)
        p_M = np.repeat(locked.p_M[None], len(time_s), axis=0)
        return p_M, -p_M / np.linalg.norm(p_M, axis=1, keepdims=True)

    def hidden(self, locked: Smr, p_M: Vector, normal_M: Vector) -> str:
        """Return why an SMR at ``p_M`` (3,) is not visible now; empty if it is."""
        if why := self._cover(locked.arm or locked.owner.removeprefix("nest ")):
            return why
        acceptance = math.pi
        if locked.arm is not None:
            acceptance = next(arm.smr_acceptance for arm in self._plant.config.arms if arm.name == locked.arm)
        why = why_hidden(self._plant.config.tracker, p_M, normal_M, acceptance)
        return why or self._beam_obstacle(p_M, locked.arm)
