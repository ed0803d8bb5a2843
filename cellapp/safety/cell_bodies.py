"""Bodies of the cell from its profile, with the nominal geometry or a calibrated one."""

from __future__ import annotations

import math

import numpy as np

from cellapp.errors import InputError
from cellapp.model import CellModel
from cellapp.model.nominal import nominal_arm, pose_matrix
from cellapp.profile import Profile
from cellapp.safety.bodies import ArmBodies
from cellapp.safety.gate import CellBodies, TrackerField


def cell_bodies(profile: Profile, model: CellModel | None = None) -> CellBodies:
    """Bodies of the profile's cell; with a model, bases and chains of the arms are the identified ones.

    Raises
    ------
    InputError
        If the profile lacks the pose of an arm's base or of the tracker.
    """
    tracker = profile.tracker
    T_C_M = None if tracker.pose is None else pose_matrix(tracker.pose)
    arms = {}
    for name, arm in profile.arms.items():
        if arm.base is None or T_C_M is None:
            raise InputError(f"profile {profile.name}: arms.{name}.base and tracker.pose are needed to move")
        if model is None:
            geometry = nominal_arm(arm).with_T_M_B(pose_matrix(arm.base))
        else:
            identified = model.arms[name].geometry
            geometry = identified.with_T_M_B(T_C_M @ identified.T_M_B())
        capsules = arm.type.capsules
        limits = arm.limits or tuple(joint.limit for joint in arm.type.joints)
        arms[name] = ArmBodies(
            geometry=geometry,
            frames=np.array([capsule.frame for capsule in capsules], dtype=np.int64),
            start=np.array([capsule.start for capsule in capsules]).reshape(-1, 3),
            end=np.array([capsule.end for capsule in capsules]).reshape(-1, 3),
            radius=np.array([capsule.radius for capsule in capsules]),
            limits=np.array(limits),
            normal_F=np.array(arm.smr.normal) / math.hypot(*arm.smr.normal),
            acceptance=arm.smr.acceptance,
        )
    field = None
    if T_C_M is not None:
        field = TrackerField(T_C_M, tracker.azimuth, tracker.elevation, tracker.distance)
    ceiling = math.inf if profile.plan.ceiling is None else profile.plan.ceiling
    return CellBodies(arms, field, profile.plan.clearance, profile.plan.floor, ceiling)


def home_positions(profile: Profile) -> dict[str, np.ndarray]:
    """Joint positions of each arm before and after a job, arm -> (N,) [rad]; only of arms with a home position."""
    return {name: np.array(arm.home) for name, arm in profile.arms.items() if arm.home is not None}
