"""Random, realistic parameters of hidden effects, for blind trials.

Sizes are from catalogues or estimates of strain-wave drives, encoders, pedestals and trackers of this class, for an arm
with the reach and weight of a UR10; for other arms they are scaled by torque or length.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.plant.config import ArmConfig, Array
from drivers.plant.effects.joint_axis_wobble import tilt_of_two_lobes
from drivers.plant.mechanism import gravity_torques

_POSES = 256
_UR10_REACH_M = 1.39


@dataclass(frozen=True, eq=False)
class Draw:
    """Random draws for one effect, and the quantities that scale it: arm, duration of the run [s], torques, reach."""

    rng: np.random.Generator
    arm: ArmConfig
    duration_s: float
    torques: Array  # (N,) largest gravity torque on each joint of the unloaded arm [Nm]
    reach: float  # greatest distance of the SMR from joint 1 [m], approximately

    @classmethod
    def of(cls, rng: np.random.Generator, arm: ArmConfig, duration_s: float) -> Draw:
        """Prepare draws for an arm and a run. Raises ``ValueError`` for a duration that is not positive."""
        if not 0.0 < duration_s < np.inf:
            raise ValueError(f"duration_s must be a positive time, not {duration_s:g}")
        poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (_POSES, arm.joints))
        torques = np.maximum(np.abs(gravity_torques(arm, poses)).max(axis=0), 1e-3)
        reach = float(np.hypot(arm.rows[:, 1], arm.rows[:, 2])[1:].sum())
        return cls(rng, arm, float(duration_s), torques, reach)

    def uniform(self, low: float, high: float) -> float:
        """Draw between two numbers."""
        return float(self.rng.uniform(low, high))

    def log_uniform(self, low: float, high: float) -> float:
        """Draw between two positive sizes, uniform in the logarithm."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def signed_log_uniform(self, low: float, high: float) -> float:
        """Like ``log_uniform``, with a random sign."""
        return float(self.rng.choice([-1.0, 1.0])) * self.log_uniform(low, high)

    def seed(self) -> int:
        """Draw the seed of a random function."""
        return int(self.rng.integers(2**31))

    def angle(self) -> float:
        """Draw a random phase [rad]."""
        return self.uniform(0.0, 2.0 * np.pi)

    def angles(self, count: int) -> list[float]:
        """Draw ``count`` random phases [rad]."""
        return [self.angle() for _ in range(count)]

    def random_vector(self, low: float, high: float) -> list[float]:
        """Draw a vector of random direction with a length between two sizes."""
        direction = self.rng.standard_normal(3)
        return list(map(float, direction / np.linalg.norm(direction) * self.log_uniform(low, high)))

    def some_joints(self) -> list[int]:
        """Draw two to four joints, counted from 1; at least two of the first three, which have long lever arms."""
        joints = self.arm.joints
        long = min(joints, 3)
        count = min(int(self.rng.integers(2, 5)), joints)
        first = self.rng.permutation(long)[: min(2, long)]
        rest = self.rng.permutation(np.setdiff1d(np.arange(joints), first))
        chosen = np.concatenate([first, rest])[:count] + 1
        return sorted(int(joint) for joint in chosen)

    def per_joint(self, low: float, high: float) -> list[float]:
        """Draw a size for each joint, uniform in the logarithm."""
        return [self.log_uniform(low, high) for _ in range(self.arm.joints)]


def _drive_stiffness(draw: Draw) -> list[float]:
    """Draw stiffnesses for drives dimensioned by torque: wind-up of 1 to 2.2 mrad under the largest torque.

    UR10, shoulder: 5.5e4 to 1.2e5 Nm/rad. Wrist drives are larger than their torque requires.
    """
    design_torque = np.maximum(draw.torques, 0.15 * draw.torques.max())
    design_torque[0] = max(design_torque[0], draw.torques.max())
    windup = draw.log_uniform(1.0e-3, 2.2e-3) * np.exp(0.2 * draw.rng.standard_normal(draw.arm.joints))
    return list(map(float, design_torque / windup))


def _joint_compliance(draw: Draw) -> dict[str, Any]:
    stiffness = _drive_stiffness(draw)
    if draw.rng.random() < 0.7:
        return {"stiffness": stiffness}
    knee = np.maximum(draw.uniform(0.15, 0.45) * draw.torques, 0.5)
    return {
        "stiffness": stiffness,
        "soft_stiffness": (draw.uniform(0.65, 0.85) * np.array(stiffness)).tolist(),
        "knee": knee.tolist(),
    }


def _link_bending(draw: Draw) -> dict[str, Any]:
    lengths = np.hypot(draw.arm.rows[:, 1], draw.arm.rows[:, 2])
    links = sorted(int(i) + 1 for i in np.argsort(lengths)[::-1][:2])
    size = draw.reach / _UR10_REACH_M
    bending = [1e5 * size * draw.log_uniform(0.7, 1.5) for _ in links]
    return {"links": links, "bending": bending, "torsion": [0.77 * value for value in bending]}


def _transmission_error(draw: Draw) -> dict[str, Any]:
    joints = draw.some_joints()
    count = len(joints)
    if draw.rng.random() < 0.4:
        return {
            "mode": "curve",
            "joints": joints,
            "rms": [draw.log_uniform(20e-6, 200e-6) for _ in joints],
            "seed": draw.seed(),
            "lowest": int(draw.rng.integers(4, 8)),
            "highest": int(draw.rng.integers(30, 46)),
        }
    which = draw.rng.choice(["output", "generator", "both"])
    ratio = float(draw.rng.choice([80.0, 100.0, 101.0, 120.0, 160.0]))
    zero = np.zeros(count)
    one_cycle = zero if which == "output" else ratio * np.array([draw.log_uniform(15e-6, 60e-6) for _ in joints])
    two_cycles = zero if which == "output" else np.array([draw.log_uniform(15e-6, 60e-6) for _ in joints])
    output = zero if which == "generator" else np.array([draw.log_uniform(20e-6, 60e-6) for _ in joints])
    return {
        "mode": "lines",
        "joints": joints,
        "ratio": [ratio] * count,
        "eccentric": one_cycle.tolist(),
        "eccentric_phase": draw.angles(count),
        "coupling_slant": (2.0 * np.arctan(np.sqrt(ratio * two_cycles))).tolist(),
        "coupling_phase": draw.angles(count),
        "output_slant": (2.0 * np.arctan(np.sqrt(output))).tolist(),
        "output_phase": draw.angles(count),
    }


def _encoder_eccentricity(draw: Draw) -> dict[str, Any]:
    joints = draw.some_joints()
    return {
        "joints": joints,
        "eccentricity": [draw.log_uniform(1e-6, 3e-6) for _ in joints],
        "radius": [0.025] * len(joints),
        "phase": draw.angles(len(joints)),
    }


def _friction_windup(draw: Draw) -> dict[str, Any]:
    stiffness = np.array(_drive_stiffness(draw))
    # about 5 Nm and 5 % of the load at a shoulder of 122 Nm
    friction = [5.0 * draw.log_uniform(0.5, 1.5) * value / 8e4 for value in stiffness]
    return {"friction": friction, "load_friction": draw.per_joint(0.03, 0.1), "stiffness": stiffness.tolist()}


def _joint_axis_wobble(draw: Draw) -> dict[str, Any]:
    joints = draw.some_joints()
    radius = 0.06 * draw.reach / _UR10_REACH_M
    two = [draw.log_uniform(20e-6, 50e-6) * radius / tilt_of_two_lobes() for _ in joints]
    return {
        "joints": joints,
        "radius": [radius] * len(joints),
        "two_lobes": two,
        "three_lobes": [draw.uniform(0.0, 0.25) * value for value in two],
        "phase": draw.angles(len(joints)),
    }


def _joint_axis_runout(draw: Draw) -> dict[str, Any]:
    joints = draw.some_joints()
    return {
        "joints": joints,
        "radial": [draw.log_uniform(15e-6, 50e-6) for _ in joints],
        "axial": [draw.log_uniform(8e-6, 30e-6) for _ in joints],
        "harmonics": [1.0, 2.0],
        "shares": [draw.uniform(0.3, 0.8), 1.0],
        "seed": draw.seed(),
    }


def _course(draw: Draw) -> tuple[str, float, float]:
    """Draw a law and its time constant; also return the share of the drift that is reached at the end of the run."""
    law = str(draw.rng.choice(["linear", "exponential", "creep"]))
    if law == "linear":
        return law, draw.duration_s, 1.0
    if law == "exponential":
        time = draw.uniform(0.12, 0.4) * draw.duration_s
        return law, time, float(-np.expm1(-draw.duration_s / time))
    time = draw.log_uniform(0.03, 0.15) * draw.duration_s
    return law, time, float(np.log1p(draw.duration_s / time))


def _drift(draw: Draw, turn: tuple[float, float]) -> dict[str, Any]:
    law, time, at_end = _course(draw)
    return {
        "shift": [value / at_end for value in draw.random_vector(30e-6, 80e-6)],
        "turn": [value / at_end for value in draw.random_vector(*turn)],
        "law": law,
        "time": time,
    }


def _pedestal_compliance(draw: Draw) -> dict[str, Any]:
    stiffness = draw.torques.max() / draw.log_uniform(45e-6, 90e-6)
    return {
        "height": draw.uniform(0.4, 1.0),
        "bending": [float(stiffness * draw.uniform(0.85, 1.2)) for _ in range(2)],
        "torsion": float(1.5 * stiffness),
    }


def _pedestal_coupling(draw: Draw) -> dict[str, Any]:
    bending = draw.log_uniform(1.3e6, 3e6)
    return {"bending": bending, "torsion": bending * draw.uniform(0.6, 1.2), "depth": draw.uniform(0.2, 0.8)}


def _tracker_angle_error(draw: Draw) -> dict[str, Any]:
    def circle() -> list[float]:
        # second order s^2 / 4
        return [
            draw.log_uniform(8e-6, 20e-6),
            draw.angle(),
            2.0 * float(np.sqrt(draw.log_uniform(6e-6, 20e-6))),
            draw.angle(),
        ]

    return {"azimuth": circle(), "elevation": circle(), "transit": draw.signed_log_uniform(5e-6, 15e-6)}


def _target_incidence(draw: Draw) -> dict[str, Any]:
    # choose the thickness so that the error has this size at the largest incidence that the reflector accepts
    index, cosine = 1.51, np.cos(draw.arm.smr_acceptance)
    path = np.sqrt(index**2 - 1.0 + cosine**2) - cosine - (index - 1.0)
    thickness = draw.log_uniform(30e-6, 70e-6) / max(float(path), 0.01)
    return {"thickness": thickness, "index": index, "dihedral": draw.signed_log_uniform(1e-6, 3e-6)}


def _dress_pack(draw: Draw) -> dict[str, Any]:
    mix = draw.uniform(0.4, 1.2)
    return {
        "torque": draw.signed_log_uniform(4.0, 9.0) * draw.torques.max() / 122.0,
        "stiffness": 8e4 * draw.torques.max() / 122.0,
        "first": 1.0,
        "second": float(draw.rng.choice([-1.0, 1.0])) * mix,
        "centre": draw.uniform(-0.8, 0.8),
        "width": draw.uniform(0.3, 0.9),
    }


_CATALOGUED: Mapping[str, Callable[[Draw], dict[str, Any]]] = {
    "joint_compliance": _joint_compliance,
    "payload_compliance": lambda draw: {"stiffness": _drive_stiffness(draw)},
    "link_bending": _link_bending,
    "transmission_error": _transmission_error,
    "encoder_eccentricity": _encoder_eccentricity,
    "backlash": lambda draw: {
        "play": draw.per_joint(50e-6, 140e-6),
        **({"reach": [draw.log_uniform(0.05, 0.4)] * draw.arm.joints} if draw.rng.random() < 0.3 else {}),
    },
    "friction_windup": _friction_windup,
    "unsettled_measurement": lambda draw: {
        "fraction": draw.per_joint(6e-5, 1.6e-4),
        "time_constant": [draw.log_uniform(2.0, 8.0)] * draw.arm.joints,
    },
    "joint_axis_wobble": _joint_axis_wobble,
    "thermal_growth": lambda draw: {
        "expansion": draw.uniform(20e-6, 25e-6),
        "share": draw.uniform(0.6, 1.0),
        "lag": draw.log_uniform(300.0, 1800.0),
        "motor": draw.uniform(0.5e-6, 2.5e-6) * draw.reach / _UR10_REACH_M,
    },
    "joint_drift": lambda draw: {
        "drift": [draw.signed_log_uniform(30e-6, 80e-6) for _ in range(draw.arm.joints)],
        "time_constant": [draw.uniform(0.12, 0.4) * draw.duration_s] * draw.arm.joints,
    },
    "base_drift": lambda draw: _drift(draw, (30e-6, 80e-6)),
    "base_step": lambda draw: {
        "shift": draw.random_vector(20e-6, 60e-6),
        "turn": draw.random_vector(20e-6, 60e-6),
        "time": draw.uniform(0.2, 0.8) * draw.duration_s,
    },
    "target_slip": lambda draw: {
        "shift": draw.random_vector(40e-6, 150e-6),
        "time": draw.uniform(0.2, 0.8) * draw.duration_s,
    },
    "pedestal_compliance": _pedestal_compliance,
    "pedestal_coupling": _pedestal_coupling,
    "tracker_scale": lambda draw: {"ppm": draw.signed_log_uniform(2.0, 10.0)},
    "tracker_angle_error": _tracker_angle_error,
    "tracker_distance_offset": lambda draw: {"offset": draw.signed_log_uniform(8e-6, 30e-6)},
    "target_incidence": _target_incidence,
    "tracker_drift": lambda draw: _drift(draw, (8e-6, 25e-6)),
    "joint_axis_runout": _joint_axis_runout,
}
_UNCATALOGUED: Mapping[str, Callable[[Draw], dict[str, Any]]] = {
    "dress_pack": _dress_pack,
    "crosstalk": lambda draw: {"amplitude": draw.signed_log_uniform(150e-6, 350e-6), "phase": draw.angle()},
    "base_sway": lambda draw: {
        "shift": draw.random_vector(30e-6, 70e-6),
        "period": draw.uniform(1500.0, 4500.0),
        "phase": draw.angle(),
    },
    "tool_sag": lambda draw: {"shift": draw.random_vector(60e-6, 140e-6)},
    "wrist_cable": lambda draw: {
        "amplitude": draw.signed_log_uniform(40e-6, 90e-6) / max(float(np.hypot(*draw.arm.smr_offset[:2])), 0.02),
        "phase": draw.angle(),
    },
    "draught": lambda draw: {
        "angle": draw.signed_log_uniform(9e-6, 20e-6),
        "period": draw.uniform(1200.0, 3600.0),
        "phase": draw.angle(),
    },
    "elbow_hose": lambda draw: {
        "angle": draw.signed_log_uniform(100e-6, 250e-6),
        "share": float(draw.rng.choice([-1.0, 1.0])) * draw.uniform(0.4, 1.2),
        "centre": draw.uniform(-0.8, 0.8),
        "width": draw.uniform(0.3, 0.9),
    },
    "joint_coupling": lambda draw: {
        "joint": 3,
        "first": 2,
        "second": min(4, draw.arm.joints),
        "amplitude": draw.signed_log_uniform(150e-6, 400e-6),
        "orders": draw.rng.integers(1, 4, 2).tolist(),
        "phases": draw.angles(2),
    },
    "warm_floor": lambda draw: {"per_kelvin": draw.random_vector(60e-6, 150e-6)},
    "workspace_field": lambda draw: {
        "rms": draw.log_uniform(80e-6, 200e-6),
        "length": draw.uniform(0.4, 0.9),
        "seed": draw.seed(),
    },
}
_ONLY_MOVING: Mapping[str, Callable[[Draw], dict[str, Any]]] = {
    # filters and drives of controllers: an estimate
    "drive_lag": lambda draw: {"time_constant": draw.per_joint(0.01, 0.03)},
    # first modes of arms of this class lie at some 8 to 15 Hz
    "joint_vibration": lambda draw: {"stiffness": _drive_stiffness(draw), "damping": draw.log_uniform(0.02, 0.08)},
}

REALISTIC: tuple[str, ...] = tuple(_CATALOGUED)
"""Effects that robots, trackers and pedestals are known to have."""

OUTSIDE: tuple[str, ...] = tuple(_UNCATALOGUED)
"""Effects outside the catalogue."""

ONLY_MOVING: tuple[str, ...] = tuple(_ONLY_MOVING)
"""Effects that act only during motion."""


def suggest(slug: str, rng: np.random.Generator, arm: ArmConfig, duration_s: float = 18000.0) -> dict[str, Any]:
    """Draw parameters of one effect at a realistic size, in the form of ``ArmConfig.effects``.

    Parameters
    ----------
    slug : str
        One of ``REALISTIC``, ``OUTSIDE`` or ``ONLY_MOVING``.
    rng : numpy.random.Generator
        Draws joints, signs, phases, sizes and onsets; the same state gives the same parameters.
    arm : ArmConfig
        Its reach, weight and SMR scale the sizes.
    duration_s : float
        Duration of the run [s]; onsets and time constants lie within it.

    Raises ``ValueError`` for a slug that does not exist or a duration that is not positive.
    """
    factories = {**_CATALOGUED, **_UNCATALOGUED, **_ONLY_MOVING}
    if slug not in factories:
        raise ValueError(f"unknown effect '{slug}'; effects are {', '.join(sorted(factories))}")
    return factories[slug](Draw.of(rng, arm, duration_s))


# -- Random parameters of hidden effects whose laws differ in shape from those that ``suggest`` draws -----------------
#
# A discovery that knows an effect by one law meets the same cause here with another law: displacements differ by about
# 5 to 30 %. Sizes are those of ``suggest``.


_Parameters = dict[str, Any]
_Law = Callable[[Draw, _Parameters], _Parameters]


def _one_of(*laws: _Law) -> _Law:
    """Draw one of several laws."""
    return lambda draw, plain: laws[int(draw.rng.integers(len(laws)))](draw, plain)


def _times(factor: float, values: list[float]) -> list[float]:
    return list(map(float, factor * np.array(values)))


def _three_stages(draw: Draw, plain: _Parameters) -> _Parameters:
    stiff, low = plain["stiffness"], draw.uniform(0.1, 0.2)
    return {
        "law": "three_stage",
        "first": _times(draw.uniform(0.45, 0.6), stiff),
        "second": _times(draw.uniform(0.7, 0.85), stiff),
        "third": stiff,
        "first_knee": (low * draw.torques).tolist(),
        "second_knee": (draw.uniform(0.4, 0.6) * draw.torques).tolist(),
    }


def _other_thermal_growth(draw: Draw, plain: _Parameters) -> _Parameters:
    if draw.rng.random() < 0.5:
        return {"law": "saturating", **plain, "limit": draw.uniform(5.0, 12.0)}
    lag = draw.log_uniform(200.0, 500.0)
    return {
        "law": "two_lags",
        **plain,
        "lag": lag,
        "slow_lag": draw.uniform(8.0, 20.0) * lag,
        "slow_share": draw.uniform(0.3, 0.6),
    }


def _other_pedestal_compliance(draw: Draw, plain: _Parameters) -> _Parameters:
    compliance = 1.0 / np.array([*plain["bending"], plain["torsion"]])
    mean = float(np.sqrt(compliance[0] * compliance[1]))
    cross = [float(draw.rng.choice([-1.0, 1.0])) * draw.uniform(0.08, 0.25) * mean for _ in range(3)]
    pivot = [draw.uniform(-0.3, 0.3), draw.uniform(-0.3, 0.3), -plain["height"] * draw.uniform(0.3, 0.8)]
    return {"law": "frame", "pivot": pivot, "direct": compliance.tolist(), "cross": cross}


def _other_pedestal_coupling(draw: Draw, plain: _Parameters) -> _Parameters:
    softer = draw.uniform(0.25, 0.5)  # at small moments, so that the size stays
    return {
        "law": "hardening",
        "bending": softer * plain["bending"],
        "torsion": softer * plain["torsion"],
        "depth": plain["depth"],
        "limit": draw.uniform(40.0, 120.0),
    }


def _other_transmission_error(draw: Draw, plain: _Parameters) -> _Parameters:
    joints = plain["joints"]
    ratio = float(draw.rng.choice([50.0, 80.0, 100.0, 120.0]))
    second = draw.uniform(6.0, 24.0)
    return {
        "mode": "meshing",
        "joints": joints,
        "ratio": [ratio] * len(joints),
        "line": [draw.log_uniform(30e-6, 80e-6) for _ in joints],
        "line_phase": draw.angles(len(joints)),
        "depth": [draw.uniform(0.3, 0.6) for _ in joints],
        "depth_phase": draw.angles(len(joints)),
        "second_cycles": [second] * len(joints),
        "second": [draw.log_uniform(15e-6, 40e-6) for _ in joints],
        "second_phase": draw.angles(len(joints)),
    }


def _other_encoder_eccentricity(draw: Draw, plain: _Parameters) -> _Parameters:
    sizes = np.array(plain["eccentricity"]) / np.array(plain["radius"])
    tilt = [2.0 * float(np.sqrt(draw.uniform(0.08, 0.25) * size)) for size in sizes]
    return {"law": "tilted", **plain, "tilt": tilt, "tilt_phase": draw.angles(len(tilt))}


def _other_joint_axis_wobble(draw: Draw, plain: _Parameters) -> _Parameters:
    sets = ([1.0], [3.0], [4.0], [1.0, 3.0], [2.0, 3.0, 4.0])
    harmonics = sets[int(draw.rng.integers(len(sets)))]
    return {
        "law": "harmonics",
        "joints": plain["joints"],
        "tilt": [draw.log_uniform(25e-6, 60e-6) for _ in plain["joints"]],
        "harmonics": harmonics,
        "shares": [draw.uniform(0.5, 1.0) for _ in harmonics],
        "seed": draw.seed(),
    }


def _other_joint_axis_runout(draw: Draw, plain: _Parameters) -> _Parameters:
    sets = ([3.0], [2.0, 4.0], [1.0, 2.0, 5.0])
    harmonics = sets[int(draw.rng.integers(len(sets)))]
    return {**plain, "harmonics": harmonics, "shares": [draw.uniform(0.5, 1.0) for _ in harmonics]}


def _other_course(draw: Draw, turn: tuple[float, float]) -> _Parameters:
    twist = {"shift": draw.random_vector(30e-6, 80e-6), "turn": draw.random_vector(*turn)}
    if draw.rng.random() < 0.5:
        time = draw.uniform(1.2, 2.4) * draw.duration_s
        return {**twist, "law": "sinusoidal", "time": time, "phase": draw.angle()}
    return {**twist, "law": "wandering", "time": draw.uniform(0.5, 1.0) * draw.duration_s, "seed": draw.seed()}


def _creeping(draw: Draw, plain: _Parameters) -> _Parameters:
    share, time = draw.uniform(0.3, 0.6), draw.uniform(0.03, 0.1) * draw.duration_s
    return {"law": "creeping", **plain, "creeping": share, "time_constant": time}


def _other_tracker_angle_error(draw: Draw, plain: _Parameters) -> _Parameters:
    def harmonics() -> list[float]:
        return [draw.log_uniform(3e-6, 10e-6), draw.angle(), draw.log_uniform(2e-6, 6e-6), draw.angle()]

    return {"law": "higher", **plain, "azimuth_higher": harmonics(), "elevation_higher": harmonics()}


_OTHER: Mapping[str, _Law] = {
    "joint_compliance": _one_of(
        _three_stages,
        lambda draw, plain: {
            "law": "stiffening",
            "stiffness": plain["stiffness"],
            "soft_stiffness": _times(draw.uniform(0.35, 0.55), plain["stiffness"]),
            "knee": (draw.uniform(0.2, 0.5) * draw.torques).tolist(),
        },
        lambda draw, plain: {
            "law": "hardening",
            "stiffness": plain["stiffness"],
            # the cubic part takes this share of the largest torque
            "cubic": (draw.uniform(0.3, 0.8) * np.array(plain["stiffness"]) ** 3 / draw.torques**2).tolist(),
        },
    ),
    "payload_compliance": _one_of(
        lambda draw, plain: {"law": "off_centre", **plain, "shift": draw.random_vector(0.03, 0.09)},
        lambda draw, plain: {
            "law": "softening",
            **plain,
            "soft_stiffness": _times(draw.uniform(0.4, 0.65), plain["stiffness"]),
            "knee": (draw.uniform(0.15, 0.4) * draw.torques).tolist(),
        },
    ),
    "link_bending": lambda draw, plain: {
        "law": "shear",
        **plain,
        # of a tube half a metre long: shear adds this share to its deflection
        "shear": [12.0 * value / 0.5**2 / draw.uniform(0.8, 2.0) for value in plain["bending"]],
    },
    "transmission_error": _other_transmission_error,
    "encoder_eccentricity": _other_encoder_eccentricity,
    "backlash": _one_of(
        lambda draw, plain: {
            "law": "warm",
            "play": plain["play"],
            "reach": [draw.log_uniform(0.15, 0.6)] * draw.arm.joints,
            "per_kelvin": draw.uniform(0.01, 0.03),
        },
        lambda draw, plain: {
            "law": "many_plays",
            "play": plain["play"],
            "reach": [draw.log_uniform(0.2, 0.8)] * draw.arm.joints,
        },
    ),
    "friction_windup": lambda draw, plain: (
        {"law": "stribeck", **plain, "rise": draw.uniform(0.4, 1.0), "short": draw.uniform(0.3, 0.9)}
        if draw.rng.random() < 0.5
        else {"law": "root_load", **plain, "typical_load": (0.4 * draw.torques).tolist()}
    ),
    "unsettled_measurement": lambda draw, plain: (
        {"law": "power", **plain, "power": draw.uniform(0.5, 1.2)}
        if draw.rng.random() < 0.5
        else {
            "law": "two_rates",
            **plain,
            "slow_time_constant": _times(draw.uniform(6.0, 15.0), plain["time_constant"]),
            "slow_share": draw.uniform(0.2, 0.5),
        }
    ),
    "joint_axis_wobble": _other_joint_axis_wobble,
    "joint_axis_runout": _other_joint_axis_runout,
    "thermal_growth": _other_thermal_growth,
    "joint_drift": lambda draw, plain: {
        "law": "wandering",
        "drift": plain["drift"],
        "time": draw.uniform(0.7, 1.4) * draw.duration_s,
        "seed": draw.seed(),
    },
    "base_drift": lambda draw, plain: _other_course(draw, (30e-6, 80e-6)),
    "base_step": _creeping,
    "target_slip": _creeping,
    "pedestal_compliance": _other_pedestal_compliance,
    "pedestal_coupling": _other_pedestal_coupling,
    "tracker_scale": lambda draw, plain: {"law": "air", **plain, "per_kelvin": draw.signed_log_uniform(0.5, 2.0)},
    "tracker_angle_error": _other_tracker_angle_error,
    "tracker_distance_offset": lambda draw, plain: {"law": "growing", **plain, "length": draw.uniform(2.0, 8.0)},
    "target_incidence": lambda draw, plain: {
        "law": "power",
        "size": draw.signed_log_uniform(60e-6, 200e-6),
        "power": draw.uniform(2.7, 4.0),
        "dihedral": plain["dihedral"],
    },
    "tracker_drift": lambda draw, plain: _other_course(draw, (8e-6, 25e-6)),
    # shorter than about a hundred stops can resolve
    "workspace_field": lambda draw, plain: {
        **plain,
        "rms": draw.uniform(120e-6, 200e-6),
        "length": draw.uniform(0.25, 0.35),
    },
    "joint_coupling": lambda draw, plain: plain,
    "crosstalk": lambda draw, plain: plain,
}


def suggest_other_law(
    slug: str, rng: np.random.Generator, arm: ArmConfig, duration_s: float = 18000.0
) -> dict[str, Any]:
    """Draw parameters of one effect of ``REALISTIC`` by a law of another shape; otherwise as ``suggest``.

    Outside the catalogue, the field in space has a short length; couplings and crosstalk are those of ``suggest``.

    Raises ``ValueError`` for a slug that has no such law or a duration that is not positive.
    """
    if slug not in _OTHER:
        raise ValueError(f"effect '{slug}' has no other law; those that have are {', '.join(sorted(_OTHER))}")
    plain = suggest(slug, rng, arm, duration_s)
    if slug == "joint_compliance":
        plain = {"stiffness": plain["stiffness"]}
    return _OTHER[slug](Draw.of(rng, arm, duration_s), plain)
