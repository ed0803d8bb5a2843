"""Find the largest test cube of an arm: reachable with one orientation, free of collisions, visible to the tracker.

Seeds are admissible, visible configurations, each rotated so that its SMR faces the tracker. From each seed the joint
positions are continued over a lattice of positions along the axes of the arm's base, with the seed's orientation, as
far as all constraints hold: so all poses are on one branch of the inverse kinematics, whatever the chain.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.safety.gate import CellBodies, visible, with_margin_for_ways
from cellapp.cell.targets.invert import admissible_configurations, clear_with_others, invert
from cellapp.estimation.iso9283.norm import lattice_cube
from cellapp.robot.kinematics.chain import flange_poses, frame_poses
from cellapp.robot.kinematics.transforms import Array, apply, rotation_from_vector
from cellapp.robot.kinematics.transforms import invert as inverse_transform
from cellapp.robot.model import ArmModel

_SEEDS = 16
"""Number of orientations and branches to try."""
_STEPS_ALONG = 12
"""Lattice steps over the length of the stretched arm: steps of some 100 mm for the arms of a calibration cell."""
_LARGEST_STEP_RAD = 0.6
"""Largest joint motion between lattice neighbours [rad]; more means that a singularity is near."""
_LIMIT_MARGIN_RAD = 0.05
"""Distance from joint limits [rad]: calibrated commands differ from nominal ones by up to some 20 mrad."""
_FACING_SHARE = 0.2
"""Fraction of the visible configurations from which seeds are taken: those that face the tracker best."""
_FINER = 4
"""The chosen cube is grown in steps of the lattice step divided by this."""
_WITHIN = np.linspace(-0.5, 0.5, 3)
"""Positions along each edge at which a grown cube is checked [edge lengths]."""
REACH, LIMITS, BODIES, VIEW = "out of reach", "joint limits", "clearance", "not seen by the tracker"


@dataclass(frozen=True, eq=False)
class Region:
    """Positions that an arm reaches with one orientation.

    Attributes
    ----------
    nominal : ArmModel
        The published chain, with its base in M.
    rotation_M : array, shape (3, 3)
        Rotation of the flange; NaN for arms with fewer than six joints, where it follows from the position.
    origin_B : array, shape (3,)
        SMR of the seed in the base frame [m].
    step : float
        Lattice step [m].
    q : mapping
        Lattice position -> joint positions (N,) [rad], for positions where all constraints hold.
    refused : mapping
        Adjacent lattice position -> constraint that is violated there.
    """

    nominal: ArmModel
    rotation_M: Array
    origin_B: Array
    step: float
    q: Mapping[tuple[int, int, int], Array]
    refused: Mapping[tuple[int, int, int], str]


@dataclass(frozen=True, eq=False)
class FoundCube:
    """Largest cube: edge [m], centre (3,) [m] in B, joint positions there, constraints that a larger one violates."""

    region: Region
    edge: float
    centre_B: Array
    q: Array
    limited_by: str

    def configurations(self, position_B: Array) -> Array:
        """Return joint positions (n, N) [rad] at positions (n, 3) [m], continued from the centre; NaN if impossible."""
        n = len(position_B)
        at = np.tile(self.q, (n, 1))
        for share in (0.25, 0.5, 0.75, 1.0):
            places = self.centre_B + share * (position_B - self.centre_B)
            at, reached = _solve(self.region, places, at)
            at[~reached] = np.nan
        return at


@dataclass(frozen=True, eq=False)
class CubeSearch:
    """Search for the test cube of one arm of a cell, with the others at home.

    ``arm`` is the model whose published chain is driven; ``cell`` has the bodies for the gate.
    """

    cell: CellBodies
    homes: Mapping[str, Array]
    name: str
    arm: ArmModel
    seed: int

    def cubes(self) -> list[FoundCube]:
        """Return the largest cube of each orientation, largest first; empty if no configuration is admissible."""
        found = []
        for q, rotation_M in self._seeds():
            region = self._region(q, rotation_M)
            if region is not None:
                found.append(self._on_lattice(region))
        largest = max((one.edge for one in found), default=0.0)
        grown = [self._enlarged(one) if one.edge > largest - one.region.step else one for one in found]
        return sorted(grown, key=lambda one: -round(one.edge, 6))

    def holds(self, q: Array) -> list[str]:
        """Return the first violated constraint of configurations (n, N) [rad]; empty text if all hold."""
        low, high = self.cell.arms[self.name].limits.T
        n = len(q)
        words = np.full(n, LIMITS, dtype=object)
        rows = np.flatnonzero(np.all((q >= low + _LIMIT_MARGIN_RAD) & (q <= high - _LIMIT_MARGIN_RAD), axis=1))
        words[rows] = BODIES
        if len(rows):
            rows = rows[clear_with_others(with_margin_for_ways(self.cell), self.homes, {self.name: q[rows]})]
        words[rows] = VIEW
        if len(rows):
            others = {other: np.tile(at, (len(rows), 1)) for other, at in self.homes.items() if other != self.name}
            words[rows[visible(self.cell, self.name, q[rows], others)]] = ""
        return [str(word) for word in words]

    @property
    def nominal(self) -> ArmModel:
        """The published chain alone, with its base in M."""
        return replace(self.arm, geometry=self.arm.nominal, effects=(), network=None, posterior=None)

    def _seeds(self) -> list[tuple[Array, Array]]:
        """Choose configurations (N,) far apart; return each with a rotation (3, 3) where its SMR faces the tracker."""
        liked = admissible_configurations(self.cell, self.homes, self.name, self.seed)
        if not len(liked):
            return []
        rotations, origins = flange_poses(self.nominal.geometry, liked)
        normal = rotations @ self.cell.arms[self.name].normal_F
        to_tracker = -(origins + rotations @ self.nominal.geometry.tool)
        to_tracker /= np.linalg.norm(to_tracker, axis=1, keepdims=True)
        facing = np.argsort(-np.einsum("na,na->n", normal, to_tracker), kind="stable")
        best = facing[: max(_SEEDS, int(_FACING_SHARE * len(liked)))]
        chosen = [int(best[0])]
        away = np.full(len(best), np.inf)
        while len(chosen) < min(_SEEDS, len(best)):
            away = np.minimum(away, np.abs(liked[best] - liked[chosen[-1]]).max(axis=1))
            chosen.append(int(best[np.argmax(away)]))
        return [(liked[k], _turned(normal[k], to_tracker[k]) @ rotations[k]) for k in chosen]

    def _region(self, q: Array, rotation_M: Array) -> Region | None:
        """Return what is reached from a seed with its rotation; None if the seed itself violates a constraint."""
        nominal = self.nominal
        geometry = nominal.geometry
        rotations, origins = flange_poses(geometry, q[None])
        origin_B = apply(inverse_transform(geometry.T_M_B()), origins + rotations @ geometry.tool)[0]
        if geometry.joints < 6:
            rotation_M = np.full((3, 3), np.nan)
        step = _arm_length(nominal) / _STEPS_ALONG
        region = Region(nominal, rotation_M, origin_B, step, {}, {})
        start, reached = _solve(region, origin_B[None], q[None])
        if not reached[0] or self.holds(start)[0]:
            return None
        known: dict[tuple[int, int, int], Array] = {(0, 0, 0): start[0]}
        refused: dict[tuple[int, int, int], str] = {}
        frontier = [(0, 0, 0)]
        while frontier:
            frontier = self._step(region, known, refused, frontier)
        return replace(region, q=known, refused=refused)

    def _step(
        self,
        region: Region,
        known: dict[tuple[int, int, int], Array],
        refused: dict[tuple[int, int, int], str],
        frontier: list[tuple[int, int, int]],
    ) -> list[tuple[int, int, int]]:
        """Continue to the lattice neighbours of ``frontier``; return those where all constraints hold."""
        new: dict[tuple[int, int, int], Array] = {}
        for place in frontier:
            for axis, sign in product(range(3), (-1, 1)):
                beside = list(place)
                beside[axis] += sign
                key = (beside[0], beside[1], beside[2])
                if key not in known and key not in refused and key not in new:
                    new[key] = known[place]
        if not new:
            return []
        keys, starts = list(new), np.array(list(new.values()))
        q, reached = _solve(region, region.origin_B + region.step * np.array(keys, dtype=np.float64), starts)
        near = np.abs(q - starts).max(axis=1) <= _LARGEST_STEP_RAD
        ok_at = (reached & near).tolist()
        words = self.holds(np.where((reached & near)[:, None], q, 0.0))
        for key, at, ok, word in zip(keys, q, ok_at, words, strict=True):
            if ok and not word:
                known[key] = at
            else:
                refused[key] = word if ok else REACH
        return [key for key in keys if key in known]

    def _on_lattice(self, region: Region) -> FoundCube:
        """Return the largest cube of the lattice."""
        keys = np.array(list(region.q))
        low = keys.min(axis=0)
        held: NDArray[np.bool_] = np.zeros(keys.max(axis=0) - low + 1, dtype=np.bool_)
        held[tuple((keys - low).T)] = True
        found = lattice_cube(held)
        assert found is not None
        steps, first = found
        corner = np.array(first) + low
        centre = region.origin_B + region.step * (corner + 0.5 * steps)
        inside = [key for key in region.q if all(c <= k <= c + steps for c, k in zip(corner, key, strict=True))]
        middle = min(inside, key=lambda key: float(np.abs(np.array(key) - corner - 0.5 * steps).max()))
        q, reached = _solve(region, centre[None], region.q[middle][None])
        at = q[0] if reached[0] else region.q[middle]
        return FoundCube(region, steps * region.step, centre, at, _limits_beside(region, corner, steps))

    def _enlarged(self, cube: FoundCube) -> FoundCube:
        """Return the cube grown and shifted by fractions of a lattice step, as far as all constraints hold."""
        if cube.edge == 0.0:
            return cube
        part = cube.region.step / _FINER
        shifts = part * np.array(list(product((0.0, 1.0, -1.0), repeat=3)))
        for grown in range(_FINER - 1, 0, -1):
            edge = cube.edge + grown * part
            within = edge * np.array(list(product(_WITHIN, repeat=3)))
            places = cube.centre_B + shifts[:, None] + within
            q = cube.configurations(places.reshape(-1, 3))
            words = self.holds(np.nan_to_num(q))
            held = np.array([not word for word in words]) & ~np.isnan(q).any(axis=1)
            fits = np.flatnonzero(held.reshape(len(shifts), -1).all(axis=1))
            if len(fits):
                centre = cube.centre_B + shifts[fits[0]]
                return replace(cube, edge=edge, centre_B=centre, q=cube.configurations(centre[None])[0])
        return cube


def _solve(region: Region, position_B: Array, start: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return joint positions (n, N) [rad] at positions (n, 3) [m] in B, with the region's rotation; and success."""
    n = len(position_B)
    position_M = apply(region.nominal.geometry.T_M_B(), position_B)
    rotation_M = np.broadcast_to(region.rotation_M, (n, 3, 3))
    usable: NDArray[np.bool_] = np.asarray(np.isfinite(start).all(axis=1))
    found = invert(region.nominal, position_M, rotation_M, np.where(usable[:, None], start, 0.0))
    return found.q, found.reached & usable


def _turned(direction: Array, to: Array) -> Array:
    """Return the smallest rotation (3, 3) from one unit vector to another."""
    axis = np.cross(direction, to)
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, direction @ to))
    return rotation_from_vector(axis * (angle / sine if sine > 0.0 else 0.0))


def _arm_length(arm: ArmModel) -> float:
    """Return the length of the stretched arm [m]: distances along the chain, which do not depend on the joints."""
    origins = frame_poses(arm.geometry, np.zeros((1, arm.geometry.joints)))[1][:, 0]
    return float(np.linalg.norm(np.diff(origins, axis=0), axis=1).sum() + np.linalg.norm(arm.geometry.tool))


def _limits_beside(region: Region, corner: NDArray[np.intp], steps: int) -> str:
    """Return the constraints that are violated one lattice step around the cube, the most frequent first."""
    counted = Counter(
        word
        for key, word in region.refused.items()
        if all(c - 1 <= k <= c + steps + 1 for c, k in zip(corner.tolist(), key, strict=True))
    )
    return ", ".join(word for word, _ in counted.most_common())
