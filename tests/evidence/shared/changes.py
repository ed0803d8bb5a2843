"""Changes of a simulated cell between calibration and check, made in the plant only."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant
from cellapp.estimation.monitoring.check.belief import TRACKER
from cellapp.ground.profile import Profile
from cellapp.ground.profile.schema import Pose
from cellapp.robot.kinematics.transforms import Array, invert, rotation_from_vector, transform
from cellapp.robot.model.nominal import pose_matrix
from drivers.plant import Plant
from drivers.plant.mechanism import Mechanism
from drivers.plant.transforms import inverse, rigid, transform_points

_LINK_TWISTS = {"a": 0, "alpha": 3, "beta": 4}
"""Component of the twist in a link's D-H frame, by parameter."""
_RADIUS_M = 0.025
"""Radius of an encoder's disc."""
_MOST = {"joint_compliance": 5e-5, "backlash": 1e-3, "encoder_eccentricity": 5e-4}
"""Largest plausible change: compliance [rad/Nm], full play [rad], amplitude [rad]."""
Moved = Callable[[Plant], Array]
"""Plant -> positions of the SMRs of all arms at the stops, arm after arm, (m, 3) [m]."""


@dataclass(frozen=True, eq=False)
class PlantChange:
    """A change: its group, its name in the check, and the plant that has it.

    ``motion`` (4, 4) is the motion of the tracker's readings, or of a base in the tracker frame, if one moved.
    """

    group: str
    arm: str
    what: str
    plant: Plant
    motion: Array | None = None


def parameter_plant(profile: Profile, arm: str, name: str, change: float) -> Plant:
    """Build the cell with one D-H parameter of an arm changed, by [m] or [rad]."""
    plant = build_plant(profile)
    word = name.rstrip("0123456789")
    joint = int(name.removeprefix(word)) - 1
    if word == "theta":
        plant.change_mechanism(arm, partial(zero_shifted, joint=joint, angle=change))
    elif word == "d":
        plant.change_mechanism(arm, partial(lengthened, joint=joint, length=change))
    else:
        twist = np.zeros(6)
        twist[_LINK_TWISTS[word]] = change
        plant.change_mechanism(arm, partial(link_moved, joint=joint, twist=twist))
    return plant


def remounted_smr(profile: Profile, arm: str, shift_F: Array) -> Profile:
    """Return the profile with the SMR shifted on the flange, by (3,) [m]."""
    smr = profile.arms[arm].smr
    assert not isinstance(smr.offset, str)
    offset = tuple((np.array(smr.offset) + shift_F).tolist())
    changed = profile.arms[arm].model_copy(update={"smr": smr.model_copy(update={"offset": offset})})
    return profile.model_copy(update={"arms": {**profile.arms, arm: changed}})


def moved_base(profile: Profile, arm: str, motion_C: Array) -> Profile:
    """Return the profile with an arm's base moved, by a motion (4, 4) in the cell's frame."""
    base = profile.arms[arm].base
    assert base is not None
    changed = profile.arms[arm].model_copy(update={"base": _pose_after(base, motion_C)})
    return profile.model_copy(update={"arms": {**profile.arms, arm: changed}})


def moved_tracker(profile: Profile, motion_C: Array) -> Profile:
    """Return the profile with the tracker moved, by a motion (4, 4) in the cell's frame."""
    assert profile.plant is not None
    assert profile.tracker.pose is not None
    pose = _pose_after(profile.plant.tracker_pose or profile.tracker.pose, motion_C)
    return profile.model_copy(update={"plant": profile.plant.model_copy(update={"tracker_pose": pose})})


def small_motion(rng: np.random.Generator, size: float, about: Array) -> Array:
    """Draw a motion (4, 4): ``size`` [m] in a random direction, ``size`` [rad] about a random axis through
    ``about``."""
    shift, turn = rng.standard_normal((2, 3))
    rotation = rotation_from_vector(size * turn / np.linalg.norm(turn))
    return transform(rotation, about - rotation @ about + size * shift / np.linalg.norm(shift))


def rigid_changes(profile: Profile, sizes: tuple[float, ...], rng: np.random.Generator) -> Iterator[PlantChange]:
    """Yield the cell with the tracker, each base and each SMR moved by each of the sizes [m, rad]."""
    plant = build_plant(profile)
    first = next(iter(profile.arms))
    T_M_C = plant.true_T_M_B(first) @ invert(plant.true_T_C_B(first))
    for size in sizes:
        motion_C = small_motion(rng, size, invert(T_M_C)[:3, 3])
        after = moved_tracker(profile, motion_C)
        motion = invert(T_M_C @ motion_C @ invert(T_M_C))
        yield PlantChange("tracker", TRACKER, "tracker", build_plant(after), motion)
        for arm in profile.arms:
            motion_C = small_motion(rng, size, plant.true_T_C_B(arm)[:3, 3])
            motion = T_M_C @ motion_C @ invert(T_M_C)
            yield PlantChange(
                "base", arm, f"base of arm {arm}", build_plant(moved_base(profile, arm, motion_C)), motion
            )
            shift = rng.standard_normal(3)
            after = remounted_smr(profile, arm, size * shift / np.linalg.norm(shift))
            yield PlantChange("smr", arm, f"SMR of arm {arm}", build_plant(after))


def effect_changes(profile: Profile, moved_m: float, at_stops: Moved) -> Iterator[PlantChange]:
    """Yield stiffness, play and eccentricity of every joint, changed so that the SMR moves by ``moved_m`` rms at the
    stops.

    Left out are joints that no plausible change moves so far.
    """
    before = at_stops(build_plant(profile))
    count = len(before) / len(profile.arms)
    for arm, its in profile.arms.items():
        for joint in range(len(its.type.joints)):
            for effect, most in _MOST.items():
                try_size = 0.1 * most
                moved = at_stops(build_plant(with_effect(profile, arm, effect, joint, try_size))) - before
                rms = float(np.sqrt(np.sum(moved**2) / count))
                size = try_size * moved_m / max(rms, 1e-12)
                if size <= most:
                    plant = build_plant(with_effect(profile, arm, effect, joint, size))
                    yield PlantChange("effect", arm, f"{effect} {joint + 1}", plant)


def with_effect(profile: Profile, arm: str, effect: str, joint: int, size: float) -> Profile:
    """Return the profile with more compliance [rad/Nm], play [rad] or eccentricity [rad] of one joint (from 0)."""
    assert profile.plant is not None
    count = len(profile.arms[arm].type.joints)
    hidden: dict[str, dict[str, Any]] = {name: dict(own) for name, own in profile.plant.effects.get(arm, {}).items()}
    own = hidden.get(effect)
    if effect == "joint_compliance":
        stiffness = np.array((own or {}).get("stiffness", [np.inf] * count), dtype=np.float64)
        stiffness[joint] = 1.0 / (1.0 / stiffness[joint] + size)
        hidden[effect] = {**(own or {}), "stiffness": stiffness.tolist()}
    elif effect == "backlash":
        play = np.array((own or {}).get("play", [0.0] * count), dtype=np.float64)
        play[joint] += size
        hidden[effect] = {**(own or {}), "play": play.tolist()}
    else:
        hidden[effect] = _more_eccentric(own, joint, size)
    effects = {**profile.plant.effects, arm: hidden}
    return profile.model_copy(update={"plant": profile.plant.model_copy(update={"effects": effects})})


def _more_eccentric(own: Mapping[str, Any] | None, joint: int, size: float) -> dict[str, Any]:
    lists: dict[str, list[Any]] = {
        key: list((own or {}).get(key, [])) for key in ("joints", "eccentricity", "radius", "phase")
    }
    if joint + 1 in lists["joints"]:
        place = lists["joints"].index(joint + 1)
        lists["eccentricity"][place] += size * lists["radius"][place]
        return lists
    for key, value in zip(lists, (joint + 1, size * _RADIUS_M, _RADIUS_M, 0.7), strict=True):
        lists[key].append(value)
    return lists


def _pose_after(pose: Pose, motion: Array) -> Pose:
    """Return a pose of the profile after a motion in its own frame of reference."""
    T = motion @ pose_matrix(pose)
    rpy = Rotation.from_matrix(T[:3, :3]).as_euler("xyz").tolist()
    return pose.model_copy(update={"position": tuple(T[:3, 3].tolist()), "rpy": tuple(rpy)})


# -- changes of a true mechanism between two days, as by a collision, a repair or a slipping encoder ---------------


def zero_shifted(mechanism: Mechanism, joint: int, angle: float) -> Mechanism:
    """Return the mechanism whose ``joint`` (from 0) is truly ``angle`` [rad] further at the same reading."""
    zeros = mechanism.zeros.copy()
    zeros[joint] += angle
    return replace(mechanism, zeros=zeros)


def lengthened(mechanism: Mechanism, joint: int, length: float) -> Mechanism:
    """Return the mechanism with everything that ``joint`` (from 0) moves shifted along its axis by ``length`` [m]."""
    return _beyond(mechanism, joint, rigid(np.concatenate([length * mechanism.directions[joint], np.zeros(3)])))


def link_moved(mechanism: Mechanism, joint: int, twist: Array) -> Mechanism:
    """Return the mechanism with all beyond link ``joint`` (from 0) moved by a twist (6,) in its D-H frame [m, rad]."""
    frame = mechanism.frames[joint + 1]
    return _beyond(mechanism, joint, frame @ rigid(twist) @ inverse(frame))


def _beyond(mechanism: Mechanism, joint: int, motion: Array) -> Mechanism:
    """Return the mechanism with everything after ``joint`` moved by ``motion`` (4, 4) in B, at the zero position."""
    points, directions = mechanism.points.copy(), mechanism.directions.copy()
    centers, frames = mechanism.centers.copy(), mechanism.frames.copy()
    points[joint + 1 :] = transform_points(motion, points[joint + 1 :])
    directions[joint + 1 :] = directions[joint + 1 :] @ motion[:3, :3].T
    centers[joint:] = transform_points(motion, centers[joint:])
    frames[joint + 1 :] = motion @ frames[joint + 1 :]
    return replace(mechanism, points=points, directions=directions, centers=centers, frames=frames)
