"""Cube, plane and poses of one arm: the largest cube whose poses, and motions between them, the gate accepts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from cellapp.cell.driving.iso9283.reach import CubeSearch, FoundCube
from cellapp.cell.safety.gate import refuse_motion
from cellapp.estimation.iso9283.norm import CYCLE, DIRECTIONAL_POSES, DIRECTIONS, PLANES, plane_name, pose_positions
from cellapp.estimation.iso9283.records import IsoCube, IsoPose
from cellapp.robot.kinematics.transforms import Array, rpy_of, xyz_of

LEAST_EDGE_M = 0.05
"""Smallest useful edge [m]: a smaller cube does not represent an arm's working space."""
_APPROACH_SHARE = 0.1
"""Length of the approach relative to the cube's edge; it stays inside the cube."""
_SHARES = (1.0, 0.85, 0.7, 0.55, 0.4)
"""Sizes to try, relative to the found cube, if the gate refuses its motions."""
_MOST_TRIES = 40
WAYS = "ways between its poses"


@dataclass(frozen=True, eq=False)
class ChosenCube:
    """The test cube of one arm.

    Attributes
    ----------
    edge : float
        [m]
    centre_B : array, shape (3,)
        [m] in the arm's base.
    plane : str
    rotation_B : array, shape (3, 3)
        Flange in the base; NaN where it is free.
    position_B, q : mappings
        Pose, or pose and direction of approach as "P2 x", -> SMR (3,) [m] and nominal joint positions (N,) [rad].
    limited_by : str
    """

    edge: float
    centre_B: Array
    plane: str
    rotation_B: Array
    position_B: dict[str, Array]
    q: dict[str, Array]
    limited_by: str

    def record(self) -> IsoCube:
        """Return the cube as a result record."""
        poses = [name for name in self.q if " " not in name]
        rpy = None
        if np.isfinite(self.rotation_B).all():
            rpy = rpy_of(self.rotation_B)
        return IsoCube(
            edge_mm=self.edge * 1e3,
            centre_B=xyz_of(self.centre_B),
            plane=self.plane,
            rpy=rpy,
            poses=tuple(
                IsoPose(name=name, position_B=xyz_of(self.position_B[name]), q=tuple(self.q[name].tolist()))
                for name in poses
            ),
            limited_by=self.limited_by,
        )


def choose_cube(search: CubeSearch) -> ChosenCube | str:
    """Return the largest cube with a plane of the standard whose poses and motions the gate accepts; else why not."""
    found = search.cubes()
    if not found:
        return "no configuration is clear and seen by the tracker"
    sized = [(cube.edge * share, share, cube) for cube in found for share in _SHARES]
    sized = sorted((one for one in sized if one[0] >= LEAST_EDGE_M), key=lambda one: -round(one[0], 6))
    reason = f"the largest cube has an edge of {found[0].edge * 1e3:.0f} mm ({found[0].limited_by})"
    for edge, share, cube in sized[:_MOST_TRIES]:
        limited = cube.limited_by if share == 1.0 else f"{WAYS}, {cube.limited_by}"
        for plane in PLANES:
            chosen = _in_plane(search, replace(cube, edge=edge, limited_by=limited), plane)
            if isinstance(chosen, ChosenCube):
                return chosen
            reason = chosen
    return f"no cube of {LEAST_EDGE_M * 1e3:.0f} mm or more fits: {reason}"


def approach_name(pose: str, direction: str) -> str:
    """Return the name of the position from which a pose is approached along an axis."""
    return f"{pose} {direction}"


def directional_sequence() -> list[tuple[str, str]]:
    """Return pose and direction of each measured visit of one multi-directional cycle."""
    return [(pose, direction) for pose in DIRECTIONAL_POSES for direction in DIRECTIONS]


# -- inside -----------------------------------------------------------------------------------------------------------


def _in_plane(search: CubeSearch, cube: FoundCube, plane: tuple[str, str, str, str]) -> ChosenCube | str:
    """Return the cube with the poses in one plane, or what the gate does not accept."""
    positions = pose_positions(cube.centre_B, cube.edge, plane)
    positions |= _approaches(positions, cube.edge)
    q = cube.configurations(np.array(list(positions.values())))
    if not np.isfinite(q).all():
        return "the poses are not all reached on one branch"
    for name, word in zip(positions, search.holds(q), strict=True):
        if word:
            return f"pose {name}: {word}"
    at = dict(zip(positions, q, strict=True))
    for start, end in _ways(search, at):
        if refusal := refuse_motion(search.cell, start, end):
            return refusal
    rotation_B = search.nominal.geometry.T_M_B()[:3, :3].T @ cube.region.rotation_M
    return ChosenCube(cube.edge, cube.centre_B, plane_name(plane), rotation_B, positions, at, cube.limited_by)


def _approaches(positions: dict[str, Array], edge: float) -> dict[str, Array]:
    """Return the start of the approach to each pose along each axis: towards the centre; for P1 in + direction."""
    found = {}
    for pose in DIRECTIONAL_POSES:
        for axis, direction in enumerate(DIRECTIONS):
            inwards = 1.0 if positions["P1"][axis] >= positions[pose][axis] else -1.0
            start = positions[pose].copy()
            start[axis] += inwards * _APPROACH_SHARE * edge
            found[approach_name(pose, direction)] = start
    return found


def _ways(search: CubeSearch, q: dict[str, Array]) -> Iterator[tuple[dict[str, Array], dict[str, Array]]]:
    """Yield all straight motions of the tests, the other arms at home, and those from every position home."""
    names: Sequence[str] = [CYCLE[-1], *CYCLE]
    legs = [*pairwise(names), ("P2", "P4"), ("P4", "P2")]
    before = approach_sequence()
    legs += list(pairwise([*before, before[0]]))
    homes = dict(search.homes)
    for first, second in dict.fromkeys(legs):
        yield {**homes, search.name: q[first]}, {**homes, search.name: q[second]}
    for at in q.values():
        yield {**homes, search.name: at}, homes


def approach_sequence() -> list[str]:
    """Return all positions of one multi-directional cycle: before each visit the start of its approach."""
    return [name for pose, direction in directional_sequence() for name in (approach_name(pose, direction), pose)]
