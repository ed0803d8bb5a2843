"""The arm that the handbook's figures are drawn for, in the poses that show an effect."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS, EffectColumn, EffectContext, Law, MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.statics import Bodies
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import bodies_of, nominal_arm, pose_matrix, up_in_tracker

_SEED = 12
"""Of the random poses: the same figure each time."""
_STRETCHED = np.radians([0.0, -20.0, 10.0, -80.0, -60.0, 0.0])
"""A pose of a six-axis arm with its elbow nearly straight, far out and low: long levers, large torques."""
_FOLDED = np.radians([0.0, -140.0, 130.0, -80.0, -60.0, 0.0])
"""The same with the elbow bent."""


@dataclass(frozen=True)
class Scene:
    """An arm with its base in the tracker frame."""

    geometry: Geometry
    bodies: Bodies
    up_M: Array
    smr_normal: Array

    @classmethod
    def of(cls, profile: Profile) -> Scene:
        """The first arm of a profile with its nominal geometry.

        Raises
        ------
        InputError
            If the profile gives no pose of tracker and base: what the tracker sees would be arbitrary.
        """
        name, arm = next(iter(profile.arms.items()))
        if profile.tracker.pose is None or arm.base is None:
            raise InputError(f"{profile.name}: figures need the poses of the tracker and of arm {name}'s base")
        if len(arm.type.joints) != len(_STRETCHED):
            raise InputError(f"{profile.name}: figures are drawn for six joints, arm {name} has {len(arm.type.joints)}")
        T_M_B = np.linalg.inv(pose_matrix(profile.tracker.pose)) @ pose_matrix(arm.base)
        normal = np.array(arm.smr.normal)
        return cls(nominal_arm(arm).with_T_M_B(T_M_B), bodies_of(arm), up_in_tracker(profile), normal)

    def stretched(self, count: int) -> Array:
        """The stretched pose (count, 6) [rad]."""
        return np.tile(_STRETCHED, (count, 1))

    def folded(self, count: int) -> Array:
        """The folded pose (count, 6) [rad]."""
        return np.tile(_FOLDED, (count, 1))

    def anywhere(self, count: int) -> Array:
        """Random poses (count, 6) [rad], two thirds of a turn of each joint."""
        return np.random.default_rng(_SEED).uniform(-2.1, 2.1, (count, 6))

    def context(self, q: Array, conditions: MeasurementConditions | None = None) -> EffectContext:
        """Stops at joint positions q (n, 6) [rad]."""
        return EffectContext(
            q=q,
            conditions=conditions or MeasurementConditions(),
            geometry=self.geometry,
            bodies=self.bodies,
            up_M=self.up_M,
            smr_normal=self.smr_normal,
        )


def swept(q: Array, joint: int, degrees: Array) -> Array:
    """Poses q (n, 6) with one joint (from 1) at the angles (n,) [deg]."""
    moved = q.copy()
    moved[:, joint - 1] = np.radians(degrees)
    return moved


def joint_offset(context: EffectContext, slug: str, law: Law, parameters: Mapping[str, float]) -> Array:
    """Offset (n,) [urad] of the joint that an effect with these parameters acts on."""
    return _sum_of_columns(context, slug, law, parameters, lambda column: column.offset, "are joint offsets")


def smr_shift(context: EffectContext, slug: str, law: Law, parameters: Mapping[str, float]) -> Array:
    """Shift (n, 3) [µm] of the SMR in the tracker frame by an effect with these parameters."""
    return _sum_of_columns(context, slug, law, parameters, lambda column: column.shift_M, "shift the SMR")


def _sum_of_columns(
    context: EffectContext,
    slug: str,
    law: Law,
    parameters: Mapping[str, float],
    what_moves: Callable[[EffectColumn], Array | None],
    wanted: str,
) -> Array:
    """What an effect with these parameters moves [1e-6 of its unit]; all parameters must do what is ``wanted``."""
    found = [
        parameters[column.name] * moved
        for column in EFFECTS[slug].columns(context, law, tuple(parameters))
        if column.name in parameters and (moved := what_moves(column)) is not None
    ]
    if len(found) != len(parameters):
        raise ValueError(f"effect {slug}: {len(found)} of the parameters {', '.join(parameters)} {wanted}")
    return np.asarray(1e6 * np.sum(found, axis=0))


def lengths(vectors: Array) -> Array:
    """Length (n,) of vectors (n, 3)."""
    return np.asarray(np.linalg.norm(vectors, axis=1))
