"""SMR positions and Jacobians of one arm at its stops, for ``online``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.estimation.calibration.parameters import ParameterSet, gram_matrix
from cellapp.robot.kinematics.chain import Geometry, JointAngles, frame_poses, jacobian
from cellapp.robot.kinematics.statics import Bodies, gravity_loads
from cellapp.robot.kinematics.transforms import Array

_GRAM_VALID = 2e-3
"""Change of a parameter [m or rad] up to which the Jacobian of the planned stops is reused; it changes as much."""
_COMPLIANCE_SD = 5e-5
"""Prior standard deviation of a joint's compliance about zero [rad/Nm]: gears of such arms have 1e4 to 1e5 Nm/rad."""
_WAVE_SD = 8e-5
"""Prior standard deviation of a joint error of one cycle a turn [rad]: encoder disk 2 um off axis, 25 mm radius."""
_PLANNED_RAD = 0.01
"""Distance from the planned joint positions up to which their gravity torques are reused: they differ by a percent."""


@dataclass(frozen=True)
class Gravity:
    """Masses of the arm and the direction (3,) against gravity in the tracker frame, for its joint compliance."""

    bodies: Bodies
    up_M: Array


@dataclass(frozen=True)
class Row:
    """SMR position (3,), its derivatives (3, k + m) and the rotation of the flange (3, 3) at one stop."""

    origin: Geometry
    q: Array
    P: Array
    J: Array
    R_M_F: Array


class Rows:
    """SMR positions and their derivatives by the parameters (k), then by the joint errors (m).

    Joint errors are the compliance under gravity, if that is known, and a cosine and a sine of the joint angle. The
    residuals that they leave in the geometry are alike at neighbouring stops, and would look like a fault.
    """

    def __init__(self, parameters: ParameterSet, planned_q: Array, gravity: Gravity | None) -> None:
        self._gravity, self._planned_q, self._planned = gravity, planned_q, JointAngles.of(planned_q)
        joints, k = parameters.joints, len(parameters.columns)
        of_joints = [6 + 5 * joint for joint in range(joints)]
        of_tool = list(range(6 + 5 * joints, 9 + 5 * joints))
        missing = [column for column in of_joints + of_tool if column not in parameters.columns]
        self._columns, self._k = (*parameters.columns, *missing), k
        self.added_sds = np.full(2 * joints, _WAVE_SD)
        """Prior standard deviations (m,) of the joint errors about zero."""
        if gravity is not None:
            self.added_sds = np.concatenate([np.full(joints, _COMPLIANCE_SD), self.added_sds])
        self._joints, self._tool = ([self._columns.index(c) for c in group] for group in (of_joints, of_tool))
        self._gram_at: Array | None = None
        self._gram, self._torques = np.zeros((k, k)), np.zeros((0, joints))
        self._last: Row | None = None

    def of(self, origin: Geometry, q: Array) -> tuple[Array, Array]:
        """Compute SMR positions (3, n) [m] and derivatives (3, k + m, n) at joint positions ``q`` (n, N) [rad]."""
        P, J = jacobian(origin, JointAngles.of(q), self._columns)
        return P, self._with_added(J, q, None if self._gravity is None else self._torques_of(origin, q))

    def at(self, origin: Geometry, stop: int, q: Array) -> Row:
        """Compute the same at one stop; the last result is cached."""
        last = self._last
        if last is None or last.origin is not origin or not np.array_equal(last.q, q):
            P, J = jacobian(origin, JointAngles.of(q[None]), self._columns)
            torques = None
            if self._gravity is not None:
                planned = 0 <= stop < len(self._torques) and np.abs(self._planned_q[stop] - q).max() < _PLANNED_RAD
                torques = self._torques[stop : stop + 1] if planned else self._torques_of(origin, q[None])
            row = self._with_added(J, q[None], torques)[:, :, 0]
            self._last = last = Row(origin, q.copy(), P[:, 0], np.ascontiguousarray(row), J[:, self._tool, 0])
        return last

    def _with_added(self, J: Array, q: Array, torques: Array | None) -> Array:
        """Append to the parameters' columns those of the joint errors at ``q`` (n, N) [rad]; ``torques`` (n, N) [Nm],
        None if unknown."""
        own = J[:, self._joints]
        added = [own * np.cos(q).T, own * np.sin(q).T]
        if torques is not None:
            added.insert(0, own * torques.T)
        return np.concatenate([J[:, : self._k], *added], axis=1)

    def planned_gram(self, origin: Geometry) -> Array:
        """Return the mean of ``J^T J`` (k, k) over the planned stops; computed anew if the geometry changed much."""
        vector = origin.vector()
        if self._gram_at is None or np.max(np.abs(vector - self._gram_at)) > _GRAM_VALID:
            _, J = jacobian(origin, self._planned, self._columns[: self._k])
            self._gram, self._gram_at = gram_matrix(J) / self._planned.count, vector
            if self._gravity is not None:
                self._torques = self._torques_of(origin, self._planned_q)
        return self._gram

    def _torques_of(self, origin: Geometry, q: Array) -> Array:
        """Compute the gravity torques (n, N) [Nm]."""
        assert self._gravity is not None
        return gravity_loads(frame_poses(origin, q), self._gravity.bodies, self._gravity.up_M).joint_torques()
