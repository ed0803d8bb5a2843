"""Model inputs from a profile: nominal geometry, masses, direction of gravity, prior standard deviations."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from cellapp.ground.profile import Arm, Pose, Priors, Profile
from cellapp.ground.profile.sections import Placement
from cellapp.robot.kinematics.chain import Geometry, hayati_rows, nominal_geometry, parameter_names, parameter_unit
from cellapp.robot.kinematics.statics import Bodies
from cellapp.robot.kinematics.transforms import Array, rotation_zyx, transform

OFF_AXIS = np.array([0.05, 0.03, 0.05])
"""Typical SMR offset [m] in place of an unknown one: on the last axis, fewer parameters could be identified."""


def nominal_arm(arm: Arm) -> Geometry:
    """Return the chain that the arm's controller uses, with its base at the origin; an unknown SMR offset is zero.

    It is the published chain, or that of the factory calibration if the profile has one.
    """
    tool = np.zeros(3) if arm.smr.offset == "unknown" else np.array(arm.smr.offset)
    published = published_rows(arm)
    geometry = replace(nominal_geometry(published, tool), tied=arm.tied, bounds=arm.bounds)
    if arm.factory is None:
        return geometry
    return replace(geometry, rows=hayati_rows(controller_rows(arm), published))


def published_rows(arm: Arm) -> Array:
    """Return the D-H rows (N, 4) of the arm's type: theta, d, a, alpha [rad, m]."""
    return np.array([[joint.theta, joint.d, joint.a, joint.alpha] for joint in arm.type.joints])


def controller_rows(arm: Arm) -> Array:
    """Return the plain D-H rows (N, 4) of the controller: the published ones plus the factory's deltas, if any."""
    rows = published_rows(arm)
    return rows if arm.factory is None else rows + np.array(arm.factory.deltas).T


def bodies_of(arm: Arm) -> Bodies:
    """Return masses and centres of mass of an arm and of its payload."""
    return Bodies(
        masses=np.array([joint.mass for joint in arm.type.joints]),
        centers=np.array([joint.center_of_mass for joint in arm.type.joints]),
        payload_mass=arm.payload.mass,
        payload_center=np.array(arm.payload.center_of_mass),
    )


def joint_rates(arm: Arm, share: float = 1.0) -> tuple[Array, Array]:
    """Return joint speeds (N,) [rad/s], at a share of the profile's speed, and accelerations (N,) [rad/s^2]."""
    joints = arm.type.joints
    speeds = np.array([joint.speed for joint in joints]) * arm.speed_scale * share
    return speeds, np.array([joint.acceleration for joint in joints]) * arm.speed_scale


def pose_matrix(pose: Pose | Placement) -> Array:
    """Return ``T_C_X`` (4, 4) of an object X at ``pose`` in the cell frame C."""
    roll, pitch, yaw = pose.rpy
    return transform(rotation_zyx(yaw, pitch, roll), pose.position)


def up_in_tracker(profile: Profile) -> Array:
    """Return the upward unit vector (3,) in the tracker frame: z of the cell, or of the tracker if it has no pose."""
    if profile.tracker.pose is None:
        return np.array([0.0, 0.0, 1.0])
    return np.asarray(pose_matrix(profile.tracker.pose)[:3, :3].T @ np.array([0.0, 0.0, 1.0]))


FIXED_SD = 1e-9
"""Prior standard deviation [m, rad] of a parameter that is fixed: far below what any reading tells."""


def prior_sigmas(geometry: Geometry, priors: Priors, fixed: Iterable[str] = ()) -> dict[str, float]:
    """Map names of parameters to prior standard deviations [m, rad]; base and tool have none unless ``fixed``."""
    sigma = {"m": priors.length, "rad": priors.angle}
    return {
        name: value
        for name in parameter_names(geometry.joints)[6:-3]
        if (value := sigma[parameter_unit(name)]) is not None
    } | dict.fromkeys(fixed, FIXED_SD)
