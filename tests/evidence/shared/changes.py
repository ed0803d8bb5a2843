"""Changes of a simulated cell between calibration and check, made in the plant only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from cellapp.cell.driving.cell import build_plant
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array
from drivers.plant import Plant
from drivers.plant.mechanism import Mechanism
from drivers.plant.transforms import inverse, rigid, transform_points
from tests.sure import sure

Changed = Callable[[Profile], Plant]
"""The plant of a profile, with a change."""
_LINK_TWISTS = {"a": 0, "alpha": 3, "beta": 4}
"""Component of the twist in a link's D-H frame, by parameter."""
_RADIUS_M = 0.025
"""Radius of an encoder's disc."""


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


def shifted_plant(profile: Profile, what: str, shift: Array) -> Plant:
    """Build the cell with the "tracker" or, as "base NAME" or "smr NAME", a base or an SMR shifted by (3,) [m]."""
    kind, _, arm = what.partition(" ")
    if kind == "tracker":
        pose = sure(sure(profile.plant).tracker_pose or profile.tracker.pose)
        there = _with(pose, position=tuple((np.array(pose.position) + shift).tolist()))
        return build_plant(_with(profile, plant=_with(sure(profile.plant), tracker_pose=there)))
    its = profile.arms[arm]
    if kind == "base":
        assert its.base is not None
        its = _with(its, base=_with(its.base, position=tuple((np.array(its.base.position) + shift).tolist())))
    else:
        its = _with(its, smr=_with(its.smr, offset=tuple((np.array(its.smr.offset) + shift).tolist())))
    return build_plant(_with(profile, arms={**profile.arms, arm: its}))


def _with(one: Any, **values: Any) -> Any:
    return one.model_copy(update=values)


def worn_plant(profile: Profile, arm: str, effect: str, joint: int, size: float) -> Plant:
    """Build the cell with more compliance [rad/Nm], play [rad] or eccentricity [rad] of one joint (from 0)."""
    assert profile.plant is not None
    count = len(profile.arms[arm].type.joints)
    hidden: dict[str, dict[str, Any]] = {name: dict(own) for name, own in profile.plant.effects.get(arm, {}).items()}
    own = hidden.get(effect)
    if effect == "joint_compliance":
        softer = {"stiffness": [np.inf] * count, **(own or {})}
        for key in ("stiffness", "soft_stiffness"):
            if key in softer:
                compliance = 1.0 / np.array(softer[key], dtype=np.float64) + size * (np.arange(count) == joint)
                softer[key] = [1.0 / one if one else np.inf for one in compliance.tolist()]
        hidden[effect] = softer
    elif effect == "backlash":
        play = np.array((own or {}).get("play", [0.0] * count), dtype=np.float64)
        play[joint] += size
        hidden[effect] = {**(own or {}), "play": play.tolist()}
    else:
        hidden[effect] = _more_eccentric(own, joint, size)
    effects = {**profile.plant.effects, arm: hidden}
    return build_plant(_with(profile, plant=_with(profile.plant, effects=effects)))


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
