"""Independent check of planned motions: finely sampled, with the collision library Coal, which the gate does not use.

Link poses are plain matrix products of the profile's D-H table; shapes and meshes go to Coal as the profile gives
them. Nothing is shared with the gate but the profile.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from cellapp.ground.profile import Arm, Profile
from cellapp.ground.profile.sections import AnyObstacle, BoxObstacle, CapsuleObstacle, MeshObstacle, SphereObstacle
from cellapp.robot.kinematics.transforms import Array, rotation_zyx, transform
from cellapp.robot.model.nominal import pose_matrix
from tests.arms import dh_frames
from tests.sure import sure

_TOUCHING_FRAMES = 2
"""Two bodies of one arm whose frames differ by at most this number share a housing and may touch."""

Targets = Mapping[str, Array]
"""Arm -> joint positions (N,) [rad]."""


@dataclass(frozen=True, eq=False)
class _Body:
    """A Coal shape fixed to ``frame`` (0: base) of ``arm``, or to the cell if it belongs to no arm.

    ``centre`` and ``half`` the sizes of its bounding box, (3,) each, are in its own frame [m].
    """

    name: str
    geometry: Any
    centre: Array
    half: Array
    pose: Array
    arm: str | None
    frame: int
    obstacle: bool


class CollisionCheck:
    """The bodies of a profile's cell for Coal; without that the test is skipped."""

    def __init__(self, profile: Profile) -> None:
        self._coal = pytest.importorskip("coal")
        self._profile = profile
        self._bodies = [*self._links(), *self._obstacles()]
        self._pairs = [pair for pair in combinations(range(len(self._bodies)), 2) if self._may_not_touch(*pair)]

    def collisions(
        self, motions: Sequence[tuple[Targets, Targets]], *, timings: int = 4, samples: int = 300
    ) -> Iterator[tuple[int, str, str]]:
        """Yield the number and the two bodies of the first collision of each motion that has one.

        Each motion is run with all arms in step, and ``timings`` - 1 times with random delays and speeds of each arm,
        each time at ``samples`` instants.
        """
        rng = np.random.default_rng(0)
        for number, (start, target) in enumerate(motions):
            for timing in range(timings):
                q = {}
                for name in self._profile.arms:
                    begin, length = (0.0, 1.0) if timing == 0 else (rng.uniform(0.0, 0.5), rng.uniform(0.2, 0.5))
                    share = np.clip((np.linspace(0.0, 1.0, samples) - begin) / length, 0.0, 1.0)[:, None]
                    q[name] = start[name] + share * (target[name] - start[name])
                if bodies := self._first_collision(q):
                    yield (number, *bodies)
                    break

    def _first_collision(self, q: Targets) -> tuple[str, str] | None:
        """Return the bodies of the first collision at configurations, arm -> (n, N) [rad]; None without one."""
        poses = self._poses(q)
        reach = np.stack([np.abs(pose[:, :3, :3]) @ body.half for pose, body in zip(poses, self._bodies, strict=True)])
        centre = np.stack(
            [pose[:, :3, 3] + pose[:, :3, :3] @ body.centre for pose, body in zip(poses, self._bodies, strict=True)]
        )
        first, second = np.array(self._pairs, dtype=np.intp).reshape(-1, 2).T
        overlap = np.all(np.abs(centre[first] - centre[second]) <= reach[first] + reach[second], axis=2)
        for row, pair in np.argwhere(overlap.T):
            i, k = self._pairs[pair]
            if self._collide(self._bodies[i], poses[i][row], self._bodies[k], poses[k][row]):
                return self._bodies[i].name, self._bodies[k].name
        return None

    def _collide(self, first: _Body, first_pose: Array, second: _Body, second_pose: Array) -> bool:
        request, result = self._coal.CollisionRequest(), self._coal.CollisionResult()
        poses = [self._coal.Transform3s(pose[:3, :3], pose[:3, 3]) for pose in (first_pose, second_pose)]
        return bool(self._coal.collide(first.geometry, poses[0], second.geometry, poses[1], request, result))

    def _poses(self, q: Targets) -> list[Array]:
        """Compute the poses (n, 4, 4) in the cell frame of each body at configurations, arm -> (n, N) [rad]."""
        frames = {name: _frames(self._profile.arms[name], value) for name, value in q.items()}
        count = len(next(iter(q.values())))
        return [
            np.broadcast_to(body.pose, (count, 4, 4)) if body.arm is None else frames[body.arm][body.frame] @ body.pose
            for body in self._bodies
        ]

    def _may_not_touch(self, i: int, k: int) -> bool:
        """Return whether two bodies must keep apart by the gate's rules: what is mounted on a body may touch it."""
        first, second = self._bodies[i], self._bodies[k]
        if first.arm is not None and first.arm == second.arm and not _stands(first) and not _stands(second):
            return abs(first.frame - second.frame) > _TOUCHING_FRAMES
        if _stands(first) and _stands(second):
            return False
        if not (_stands(first) or _stands(second)):
            return True
        link, obstacle = (second, first) if _stands(first) else (first, second)
        return link.frame > 1 or (link.frame == 1 and not self._base_is_near(link.arm, obstacle))

    def _base_is_near(self, arm: str | None, obstacle: _Body) -> bool:
        """Return whether an obstacle is nearer to an arm's base than the clearance: the arm may stand on it."""
        at_zero = {name: np.zeros((1, len(one.type.joints))) for name, one in self._profile.arms.items()}
        poses = [pose[0] for pose in self._poses(at_zero)]
        place = {id(body): pose for body, pose in zip(self._bodies, poses, strict=True)}
        origin = _frames(self._profile.arms[str(arm)], at_zero[str(arm)])[0][0]
        bases = [(self._coal.Sphere(1e-9), origin)]
        bases += [(one.geometry, place[id(one)]) for one in self._bodies if one.arm == arm and one.frame == 0]
        return any(
            self._distance(geometry, pose, obstacle.geometry, place[id(obstacle)]) < self._profile.plan.clearance
            for geometry, pose in bases
        )

    def _distance(self, first: Any, first_pose: Array, second: Any, second_pose: Array) -> float:
        request, result = self._coal.DistanceRequest(), self._coal.DistanceResult()
        poses = [self._coal.Transform3s(pose[:3, :3], pose[:3, 3]) for pose in (first_pose, second_pose)]
        return float(self._coal.distance(first, poses[0], second, poses[1], request, result))

    def _links(self) -> Iterator[_Body]:
        for name, arm in self._profile.arms.items():
            for number, capsule in enumerate(arm.type.capsules):
                start, end = np.array(capsule.start), np.array(capsule.end)
                length = float(np.linalg.norm(end - start))
                geometry = self._coal.Capsule(capsule.radius, length)
                half = np.array([capsule.radius, capsule.radius, capsule.radius + 0.5 * length])
                pose = transform(_z_along(end - start), 0.5 * (start + end))
                label = f"{name}: body {number}"
                yield _Body(label, geometry, np.zeros(3), half, pose, name, capsule.frame, obstacle=False)

    def _obstacles(self) -> Iterator[_Body]:
        for name, entry in self._profile.obstacles.items():
            roll, pitch, yaw = entry.pose.rpy
            pose = transform(rotation_zyx(yaw, pitch, roll), entry.pose.position)
            geometry, centre, half = _shape(self._coal, entry)
            on_flange = entry.arm is not None and entry.fixed_to == "flange"
            frame = len(self._profile.arms[str(entry.arm)].type.joints) if on_flange else 0
            yield _Body(name, geometry, centre, half, pose, entry.arm, frame, obstacle=True)


def _stands(body: _Body) -> bool:
    """Return whether a body never moves: it is an obstacle of the cell or on a base."""
    return body.obstacle and body.frame == 0


def _shape(coal: ModuleType, entry: AnyObstacle) -> tuple[Any, Array, Array]:
    """Build a Coal shape; return it with centre and half the sizes of its bounding box, (3,) each [m]."""
    nowhere = np.zeros(3)
    if isinstance(entry, BoxObstacle):
        return coal.Box(*entry.size), nowhere, 0.5 * np.array(entry.size)
    if isinstance(entry, SphereObstacle):
        return coal.Sphere(entry.radius), nowhere, np.full(3, entry.radius)
    if isinstance(entry, MeshObstacle):
        mesh = coal.MeshLoader().load(entry.file, np.full(3, entry.scale))
        mesh.computeLocalAABB()
        low, high = mesh.aabb_local.min_, mesh.aabb_local.max_
        return mesh, 0.5 * (high + low), 0.5 * (high - low)
    half_length = 0.5 * entry.length
    if isinstance(entry, CapsuleObstacle):
        geometry, half_length = coal.Capsule(entry.radius, entry.length), half_length + entry.radius
    else:
        geometry = coal.Cylinder(entry.radius, entry.length)
    return geometry, nowhere, np.array([entry.radius, entry.radius, half_length])


def _frames(arm: Arm, q: Array) -> Array:
    """Compute the poses (N + 1, n, 4, 4) of an arm's D-H frames in the cell frame, base first, at ``q`` (n, N)."""
    rows = [[joint.theta, joint.d, joint.a, joint.alpha] for joint in arm.type.joints]
    return np.asarray(pose_matrix(sure(arm.base)) @ np.stack(dh_frames(rows, q)))


def _z_along(direction: Array) -> Array:
    """Return a rotation (3, 3) whose z axis has the given direction; the identity for a zero vector."""
    length = float(np.linalg.norm(direction))
    if length < 1e-12:
        return np.eye(3)
    z = direction / length
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)
