"""Map of what the tracker sees of each arm's workspace, before anything is planned."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.planning.candidates import draw_joints, exclusions, joint_ranges, usable
from cellapp.cell.planning.design_records import ArmView, SeenCell, ViewChange, ViewResult
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import CellBodies
from cellapp.cell.safety.visibility import TrackerField, usable_acceptance
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore
from cellapp.robot.kinematics.chain import Geometry, frame_poses
from cellapp.robot.kinematics.transforms import Array

_BATCHES = 80
"""Draws of some 12 000 configurations for the map: a thousand per cube, a share of 1 % known to a third of itself."""
_CHANGE_BATCHES = 6
"""Draws for the share after a change of the cell, always the same configurations: known to some percent of itself."""
_CUBES_ALONG = 7
"""Number of cubes along the stretched arm: some hundred millimetres each for the arms of a calibration cell."""
_EDGE_UNIT = 0.05
"""Edges of cubes are multiples of this length [m]."""
_SEED = 0x51E
_TRACKER_STEPS = {
    "the tracker 0.5 m higher": (0.0, 0.0, 0.5),
    "the tracker 0.5 m lower": (0.0, 0.0, -0.5),
    "the tracker 0.5 m nearer": (-0.5, 0.0, 0.0),
    "the tracker 1 m farther away": (1.0, 0.0, 0.0),
    "the tracker 1 m to its left": (0.0, -1.0, 0.0),
    "the tracker 1 m to its right": (0.0, 1.0, 0.0),
}
"""Displacements that are tried [m]: away from the arm's base along the ground, across to that, up."""
_NORMALS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_SAME_DIRECTION = math.cos(math.radians(20.0))
"""Viewing directions closer than this to the SMR's own are not tried (cosine of the angle)."""


def view_workspace(profile: Profile, listener: Listener = ignore, cancel: CancelToken | None = None) -> ViewResult:
    """Map what the tracker sees of each arm's workspace, as if no other arm could be in its way.

    Configurations are uniform in the plan's joint ranges.

    Raises
    ------
    InputError
        If the profile does not say where bases and tracker are.
    Cancelled
    """
    cancel = cancel or CancelToken()
    cell = cell_bodies(profile)
    arms = {}
    for number, name in enumerate(cell.arms):
        cancel.check()
        listener(Progress("view", number, len(cell.arms)))
        arms[name] = arm_view(cell, profile, name, cancel)
    listener(Progress("view", len(arms), len(arms), "done"))
    return ViewResult(profile=profile.name, arms=arms)


def arm_view(cell: CellBodies, profile: Profile, name: str, cancel: CancelToken) -> ArmView:
    """Map what the tracker sees of one arm's workspace, what excludes most, and which changes would help."""
    if cell.field is None:
        raise InputError(f"view: arm {name}: the cell has no tracker that could see its SMR; give tracker.pose")
    arm, rng = cell.arms[name], np.random.default_rng([profile.seed, _SEED])
    ranges, cubes = joint_ranges(cell, profile, name), _Cubes.around(arm.geometry)
    reachable, seen = np.zeros(cubes.count, dtype=np.intp), np.zeros(cubes.count, dtype=np.intp)
    rejected: Counter[str] = Counter()
    drawn = small = 0
    for _ in range(_BATCHES):
        cancel.check()
        draws = draw_joints(arm, cell.field.T_C_M, ranges, rng)
        found = usable(cell, cell.field, name, draws)
        reachable += cubes.counts(cell.field.T_C_M, draws.sight.smr_M.reshape(3, -1))
        seen += cubes.counts(cell.field.T_C_M, found.smr_M.T)
        rejected.update(found.rejected)
        drawn += found.drawn
        small += int(np.count_nonzero(found.incidence <= profile.plan.incidence))
    return ArmView(
        drawn=drawn,
        seen=int(seen.sum()),
        small_incidence=small,
        facing_at_random=0.5 * (1.0 - math.cos(usable_acceptance(arm.acceptance))),
        lost={constraint: count / drawn for constraint, count in rejected.items()},
        constraints=exclusions(cell, profile, name),
        changes=tuple(_changes(cell, cell.field, name, ranges, cancel)),
        edge_m=cubes.edge,
        cells=tuple(one for one in cubes.cells(reachable, seen) if cell.floor < one.centre_C[2] < cell.ceiling),
    )


def _changes(cell: CellBodies, field: TrackerField, name: str, ranges: Array, cancel: CancelToken) -> list[ViewChange]:
    """Compute the share of measurable configurations after each change and in the cell as it is; the best first."""
    changes = {"as it is": cell, **dict(_moved_trackers(cell, field, name)), **dict(_turned_smrs(cell, name))}
    found = []
    for words, changed in changes.items():
        cancel.check()
        found.append(ViewChange(change=words, seen=_share(changed, changed.field or field, name, ranges)))
    return sorted(found, key=lambda one: one.seen, reverse=True)


def _moved_trackers(cell: CellBodies, field: TrackerField, name: str) -> Iterator[tuple[str, CellBodies]]:
    T_C_M = field.T_C_M
    away = T_C_M[:3, 3] - cell.arms[name].geometry.T_M_B()[:3, 3]
    away = np.array([away[0], away[1], 0.0]) / max(math.hypot(away[0], away[1]), 1e-9)
    across, up = np.array([-away[1], away[0], 0.0]), np.array([0.0, 0.0, 1.0])
    for words, step in _TRACKER_STEPS.items():
        pose = T_C_M.copy()
        pose[:3, 3] += np.array(step) @ np.stack([away, across, up])
        yield words, replace(cell, field=replace(field, T_C_M=pose))


def _turned_smrs(cell: CellBodies, name: str) -> Iterator[tuple[str, CellBodies]]:
    arm = cell.arms[name]
    for axis, direction in _NORMALS.items():
        for sign in (1.0, -1.0):
            normal = sign * np.array(direction)
            if normal @ arm.normal_F < _SAME_DIRECTION:
                words = f"the SMR looking along {'-' if sign < 0.0 else ''}{axis} of the flange (smr.normal)"
                yield words, replace(cell, arms={**cell.arms, name: replace(arm, normal_F=normal)})


def _share(cell: CellBodies, field: TrackerField, name: str, ranges: Array) -> float:
    """Compute the share of configurations that can be measured in a cell; always from the same ones."""
    rng = np.random.default_rng(_SEED)
    batches = [
        usable(cell, field, name, draw_joints(cell.arms[name], field.T_C_M, ranges, rng))
        for _ in range(_CHANGE_BATCHES)
    ]
    return sum(len(one.q) for one in batches) / sum(one.drawn for one in batches)


@dataclass(frozen=True, eq=False)
class _Cubes:
    """Cubes along the axes of the cell frame C: edge and first corner (3,) [m], number along each axis."""

    edge: float
    low: Array
    along: int

    @classmethod
    def around(cls, geometry: Geometry) -> _Cubes:
        """Enclose all points that the SMR can reach: the length of the chain does not depend on q."""
        origins = frame_poses(geometry, np.zeros((1, geometry.joints)))[1][:, 0]
        reach = float(np.linalg.norm(np.diff(origins, axis=0), axis=1).sum() + np.linalg.norm(geometry.tool))
        edge = _EDGE_UNIT * max(1, round(reach / _CUBES_ALONG / _EDGE_UNIT))
        low = edge * np.floor((origins[0] - reach) / edge - 1e-9)
        return cls(edge, low, math.ceil(2.0 * reach / edge) + 2)

    @property
    def count(self) -> int:
        """Number of cubes."""
        return self.along**3

    def counts(self, T_C_M: Array, p_M: Array) -> NDArray[np.intp]:
        """Count the points ``p_M`` (3, n) [m], given in the tracker frame, in each cube, shape (count,)."""
        p = (T_C_M[:3, :3] / self.edge) @ p_M + ((T_C_M[:3, 3] - self.low) / self.edge)[:, None]
        x, y, z = p.astype(np.intp)  # none is negative
        return np.bincount((x * self.along + y) * self.along + z, minlength=self.count)

    def cells(self, reachable: NDArray[np.intp], seen: NDArray[np.intp]) -> Iterator[SeenCell]:
        """Yield the cubes that are reached."""
        for number in np.flatnonzero(reachable).tolist():
            place = np.array(np.unravel_index(number, (self.along,) * 3))
            x, y, z = np.round(self.low + self.edge * (place + 0.5), 6).tolist()
            yield SeenCell(centre_C=(x, y, z), reachable=int(reachable[number]), seen=int(seen[number]))
