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
class EffectSampler:
    """Random samples for one effect, and the quantities that scale it: arm, duration of the run [s], torques, reach."""

    rng: np.random.Generator
    arm: ArmConfig
    duration_s: float
    torques: Array  # (N,) largest gravity torque on each joint of the unloaded arm [Nm]
    reach: float  # greatest distance of the SMR from joint 1 [m], approximately

    @classmethod
    def of(cls, rng: np.random.Generator, arm: ArmConfig, duration_s: float) -> EffectSampler:
        """Prepare samples for an arm and a run. Raises ``ValueError`` for a duration that is not positive."""
        if not 0.0 < duration_s < np.inf:
            raise ValueError(f"duration_s must be a positive time, not {duration_s:g}")
        poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (_POSES, arm.joints))
        torques = np.maximum(np.abs(gravity_torques(arm, poses)).max(axis=0), 1e-3)
        reach = float(np.hypot(arm.rows[:, 1], arm.rows[:, 2])[1:].sum())
        return cls(rng, arm, float(duration_s), torques, reach)

    def uniform(self, low: float, high: float) -> float:
        """Sample between two numbers."""
        return float(self.rng.uniform(low, high))

    def log_uniform(self, low: float, high: float) -> float:
        """Sample between two positive sizes, uniform in the logarithm."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def signed_log_uniform(self, low: float, high: float) -> float:
        """Like ``log_uniform``, with a random sign."""
        return float(self.rng.choice([-1.0, 1.0])) * self.log_uniform(low, high)

    def seed(self) -> int:
        """Sample the seed of a random function."""
        return int(self.rng.integers(2**31))

    def angle(self) -> float:
        """Sample a random phase [rad]."""
        return self.uniform(0.0, 2.0 * np.pi)

    def angles(self, count: int) -> list[float]:
        """Sample ``count`` random phases [rad]."""
        return [self.angle() for _ in range(count)]

    def random_vector(self, low: float, high: float) -> list[float]:
        """Sample a vector of random direction with a length between two sizes."""
        direction = self.rng.standard_normal(3)
        return list(map(float, direction / np.linalg.norm(direction) * self.log_uniform(low, high)))

    def some_joints(self) -> list[int]:
        """Sample two to four joints, counted from 1; at least two of the first three, which have long lever arms."""
        joints = self.arm.joints
        long = min(joints, 3)
        count = min(int(self.rng.integers(2, 5)), joints)
        first = self.rng.permutation(long)[: min(2, long)]
        rest = self.rng.permutation(np.setdiff1d(np.arange(joints), first))
        chosen = np.concatenate([first, rest])[:count] + 1
        return sorted(int(joint) for joint in chosen)

    def per_joint(self, low: float, high: float) -> list[float]:
        """Sample a size for each joint, uniform in the logarithm."""
        return [self.log_uniform(low, high) for _ in range(self.arm.joints)]


def _drive_stiffness(sample: EffectSampler) -> list[float]:
    """Sample stiffnesses for drives dimensioned by torque: wind-up of 1 to 2.2 mrad under the largest torque.

    UR10, shoulder: 5.5e4 to 1.2e5 Nm/rad. Wrist drives are larger than their torque requires.
    """
    design_torque = np.maximum(sample.torques, 0.15 * sample.torques.max())
    design_torque[0] = max(design_torque[0], sample.torques.max())
    windup = sample.log_uniform(1.0e-3, 2.2e-3) * np.exp(0.2 * sample.rng.standard_normal(sample.arm.joints))
    return list(map(float, design_torque / windup))


def _joint_compliance(sample: EffectSampler) -> dict[str, Any]:
    stiffness = _drive_stiffness(sample)
    if sample.rng.random() < 0.7:
        return {"stiffness": stiffness}
    knee = np.maximum(sample.uniform(0.15, 0.45) * sample.torques, 0.5)
    return {
        "stiffness": stiffness,
        "soft_stiffness": (sample.uniform(0.65, 0.85) * np.array(stiffness)).tolist(),
        "knee": knee.tolist(),
    }


def _link_bending(sample: EffectSampler) -> dict[str, Any]:
    lengths = np.hypot(sample.arm.rows[:, 1], sample.arm.rows[:, 2])
    links = sorted(int(i) + 1 for i in np.argsort(lengths)[::-1][:2])
    size = sample.reach / _UR10_REACH_M
    bending = [1e5 * size * sample.log_uniform(0.7, 1.5) for _ in links]
    return {"links": links, "bending": bending, "torsion": [0.77 * value for value in bending]}


def _transmission_error(sample: EffectSampler) -> dict[str, Any]:
    joints = sample.some_joints()
    count = len(joints)
    if sample.rng.random() < 0.4:
        return {
            "mode": "curve",
            "joints": joints,
            "rms": [sample.log_uniform(20e-6, 200e-6) for _ in joints],
            "seed": sample.seed(),
            "lowest": int(sample.rng.integers(4, 8)),
            "highest": int(sample.rng.integers(30, 46)),
        }
    which = sample.rng.choice(["output", "generator", "both"])
    ratio = float(sample.rng.choice([80.0, 100.0, 101.0, 120.0, 160.0]))
    zero = np.zeros(count)
    one_cycle = zero if which == "output" else ratio * np.array([sample.log_uniform(15e-6, 60e-6) for _ in joints])
    two_cycles = zero if which == "output" else np.array([sample.log_uniform(15e-6, 60e-6) for _ in joints])
    output = zero if which == "generator" else np.array([sample.log_uniform(20e-6, 60e-6) for _ in joints])
    return {
        "mode": "lines",
        "joints": joints,
        "ratio": [ratio] * count,
        "eccentric": one_cycle.tolist(),
        "eccentric_phase": sample.angles(count),
        "coupling_slant": (2.0 * np.arctan(np.sqrt(ratio * two_cycles))).tolist(),
        "coupling_phase": sample.angles(count),
        "output_slant": (2.0 * np.arctan(np.sqrt(output))).tolist(),
        "output_phase": sample.angles(count),
    }


def _encoder_eccentricity(sample: EffectSampler) -> dict[str, Any]:
    joints = sample.some_joints()
    return {
        "joints": joints,
        "eccentricity": [sample.log_uniform(1e-6, 3e-6) for _ in joints],
        "radius": [0.025] * len(joints),
        "phase": sample.angles(len(joints)),
    }


def _friction_windup(sample: EffectSampler) -> dict[str, Any]:
    stiffness = np.array(_drive_stiffness(sample))
    # about 5 Nm and 5 % of the load at a shoulder of 122 Nm
    friction = [5.0 * sample.log_uniform(0.5, 1.5) * value / 8e4 for value in stiffness]
    return {"friction": friction, "load_friction": sample.per_joint(0.03, 0.1), "stiffness": stiffness.tolist()}


def _joint_axis_wobble(sample: EffectSampler) -> dict[str, Any]:
    joints = sample.some_joints()
    radius = 0.06 * sample.reach / _UR10_REACH_M
    two = [sample.log_uniform(20e-6, 50e-6) * radius / tilt_of_two_lobes() for _ in joints]
    return {
        "joints": joints,
        "radius": [radius] * len(joints),
        "two_lobes": two,
        "three_lobes": [sample.uniform(0.0, 0.25) * value for value in two],
        "phase": sample.angles(len(joints)),
    }


def _joint_axis_runout(sample: EffectSampler) -> dict[str, Any]:
    joints = sample.some_joints()
    return {
        "joints": joints,
        "radial": [sample.log_uniform(15e-6, 50e-6) for _ in joints],
        "axial": [sample.log_uniform(8e-6, 30e-6) for _ in joints],
        "harmonics": [1.0, 2.0],
        "shares": [sample.uniform(0.3, 0.8), 1.0],
        "seed": sample.seed(),
    }


def _course(sample: EffectSampler) -> tuple[str, float, float]:
    """Sample a law and its time constant; also return the share of the drift that is reached at the end of the run."""
    law = str(sample.rng.choice(["linear", "exponential", "creep"]))
    if law == "linear":
        return law, sample.duration_s, 1.0
    if law == "exponential":
        time = sample.uniform(0.12, 0.4) * sample.duration_s
        return law, time, float(-np.expm1(-sample.duration_s / time))
    time = sample.log_uniform(0.03, 0.15) * sample.duration_s
    return law, time, float(np.log1p(sample.duration_s / time))


def _drift(sample: EffectSampler, rotation: tuple[float, float]) -> dict[str, Any]:
    law, time, at_end = _course(sample)
    return {
        "shift": [value / at_end for value in sample.random_vector(30e-6, 80e-6)],
        "turn": [value / at_end for value in sample.random_vector(*rotation)],
        "law": law,
        "time": time,
    }


def _pedestal_compliance(sample: EffectSampler) -> dict[str, Any]:
    stiffness = sample.torques.max() / sample.log_uniform(45e-6, 90e-6)
    return {
        "height": sample.uniform(0.4, 1.0),
        "bending": [float(stiffness * sample.uniform(0.85, 1.2)) for _ in range(2)],
        "torsion": float(1.5 * stiffness),
    }


def _pedestal_coupling(sample: EffectSampler) -> dict[str, Any]:
    bending = sample.log_uniform(1.3e6, 3e6)
    return {"bending": bending, "torsion": bending * sample.uniform(0.6, 1.2), "depth": sample.uniform(0.2, 0.8)}


def _tracker_angle_error(sample: EffectSampler) -> dict[str, Any]:
    def circle() -> list[float]:
        # second order s^2 / 4
        return [
            sample.log_uniform(8e-6, 20e-6),
            sample.angle(),
            2.0 * float(np.sqrt(sample.log_uniform(6e-6, 20e-6))),
            sample.angle(),
        ]

    return {"azimuth": circle(), "elevation": circle(), "transit": sample.signed_log_uniform(5e-6, 15e-6)}


def _target_incidence(sample: EffectSampler) -> dict[str, Any]:
    # choose the thickness so that the error has this size at the largest incidence that the reflector accepts
    index, cosine = 1.51, np.cos(sample.arm.smr_acceptance)
    path = np.sqrt(index**2 - 1.0 + cosine**2) - cosine - (index - 1.0)
    thickness = sample.log_uniform(30e-6, 70e-6) / max(float(path), 0.01)
    return {"thickness": thickness, "index": index, "dihedral": sample.signed_log_uniform(1e-6, 3e-6)}


def _dress_pack(sample: EffectSampler) -> dict[str, Any]:
    mix = sample.uniform(0.4, 1.2)
    return {
        "torque": sample.signed_log_uniform(4.0, 9.0) * sample.torques.max() / 122.0,
        "stiffness": 8e4 * sample.torques.max() / 122.0,
        "first": 1.0,
        "second": float(sample.rng.choice([-1.0, 1.0])) * mix,
        "centre": sample.uniform(-0.8, 0.8),
        "width": sample.uniform(0.3, 0.9),
    }


_CATALOGUED: Mapping[str, Callable[[EffectSampler], dict[str, Any]]] = {
    "joint_compliance": _joint_compliance,
    "payload_compliance": lambda one: {"stiffness": _drive_stiffness(one)},
    "link_bending": _link_bending,
    "transmission_error": _transmission_error,
    "encoder_eccentricity": _encoder_eccentricity,
    "backlash": lambda sample: {
        "play": sample.per_joint(50e-6, 140e-6),
        **({"reach": [sample.log_uniform(0.05, 0.4)] * sample.arm.joints} if sample.rng.random() < 0.3 else {}),
    },
    "friction_windup": _friction_windup,
    "unsettled_measurement": lambda sample: {
        "fraction": sample.per_joint(6e-5, 1.6e-4),
        "time_constant": [sample.log_uniform(2.0, 8.0)] * sample.arm.joints,
    },
    "joint_axis_wobble": _joint_axis_wobble,
    "thermal_growth": lambda sample: {
        "expansion": sample.uniform(20e-6, 25e-6),
        "share": sample.uniform(0.6, 1.0),
        "lag": sample.log_uniform(300.0, 1800.0),
        "motor": sample.uniform(0.5e-6, 2.5e-6) * sample.reach / _UR10_REACH_M,
    },
    "joint_drift": lambda sample: {
        "drift": [sample.signed_log_uniform(30e-6, 80e-6) for _ in range(sample.arm.joints)],
        "time_constant": [sample.uniform(0.12, 0.4) * sample.duration_s] * sample.arm.joints,
    },
    "base_drift": lambda sample: _drift(sample, (30e-6, 80e-6)),
    "base_step": lambda sample: {
        "shift": sample.random_vector(20e-6, 60e-6),
        "turn": sample.random_vector(20e-6, 60e-6),
        "time": sample.uniform(0.2, 0.8) * sample.duration_s,
    },
    "target_slip": lambda sample: {
        "shift": sample.random_vector(40e-6, 150e-6),
        "time": sample.uniform(0.2, 0.8) * sample.duration_s,
    },
    "pedestal_compliance": _pedestal_compliance,
    "pedestal_coupling": _pedestal_coupling,
    "tracker_scale": lambda sample: {"ppm": sample.signed_log_uniform(2.0, 10.0)},
    "tracker_angle_error": _tracker_angle_error,
    "tracker_distance_offset": lambda sample: {"offset": sample.signed_log_uniform(8e-6, 30e-6)},
    "target_incidence": _target_incidence,
    "tracker_drift": lambda sample: _drift(sample, (8e-6, 25e-6)),
    "joint_axis_runout": _joint_axis_runout,
}
_UNCATALOGUED: Mapping[str, Callable[[EffectSampler], dict[str, Any]]] = {
    "dress_pack": _dress_pack,
    "crosstalk": lambda sample: {"amplitude": sample.signed_log_uniform(150e-6, 350e-6), "phase": sample.angle()},
    "base_sway": lambda sample: {
        "shift": sample.random_vector(30e-6, 70e-6),
        "period": sample.uniform(1500.0, 4500.0),
        "phase": sample.angle(),
    },
    "tool_sag": lambda sample: {"shift": sample.random_vector(60e-6, 140e-6)},
    "wrist_cable": lambda sample: {
        "amplitude": sample.signed_log_uniform(40e-6, 90e-6) / max(float(np.hypot(*sample.arm.smr_offset[:2])), 0.02),
        "phase": sample.angle(),
    },
    "draught": lambda sample: {
        "angle": sample.signed_log_uniform(9e-6, 20e-6),
        "period": sample.uniform(1200.0, 3600.0),
        "phase": sample.angle(),
    },
    "elbow_hose": lambda sample: {
        "angle": sample.signed_log_uniform(100e-6, 250e-6),
        "share": float(sample.rng.choice([-1.0, 1.0])) * sample.uniform(0.4, 1.2),
        "centre": sample.uniform(-0.8, 0.8),
        "width": sample.uniform(0.3, 0.9),
    },
    "joint_coupling": lambda sample: {
        "joint": 3,
        "first": 2,
        "second": min(4, sample.arm.joints),
        "amplitude": sample.signed_log_uniform(150e-6, 400e-6),
        "orders": sample.rng.integers(1, 4, 2).tolist(),
        "phases": sample.angles(2),
    },
    "warm_floor": lambda sample: {"per_kelvin": sample.random_vector(60e-6, 150e-6)},
    "workspace_field": lambda sample: {
        "rms": sample.log_uniform(80e-6, 200e-6),
        "length": sample.uniform(0.4, 0.9),
        "seed": sample.seed(),
    },
}
_ONLY_MOVING: Mapping[str, Callable[[EffectSampler], dict[str, Any]]] = {
    # filters and drives of controllers: an estimate
    "drive_lag": lambda sample: {"time_constant": sample.per_joint(0.01, 0.03)},
    # first modes of arms of this class lie at some 8 to 15 Hz
    "joint_vibration": lambda one: {"stiffness": _drive_stiffness(one), "damping": one.log_uniform(0.02, 0.08)},
}

REALISTIC: tuple[str, ...] = tuple(_CATALOGUED)
"""Effects that robots, trackers and pedestals are known to have."""

OUTSIDE: tuple[str, ...] = tuple(_UNCATALOGUED)
"""Effects outside the catalogue."""

ONLY_MOVING: tuple[str, ...] = tuple(_ONLY_MOVING)
"""Effects that act only during motion."""


def suggest(slug: str, rng: np.random.Generator, arm: ArmConfig, duration_s: float = 18000.0) -> dict[str, Any]:
    """Sample parameters of one effect at a realistic size, in the form of ``ArmConfig.effects``.

    Parameters
    ----------
    slug : str
        One of ``REALISTIC``, ``OUTSIDE`` or ``ONLY_MOVING``.
    rng : numpy.random.Generator
        Samples joints, signs, phases, sizes and onsets; the same state gives the same parameters.
    arm : ArmConfig
        Its reach, weight and SMR scale the sizes.
    duration_s : float
        Duration of the run [s]; onsets and time constants lie within it.

    Raises ``ValueError`` for a slug that does not exist or a duration that is not positive.
    """
    factories = {**_CATALOGUED, **_UNCATALOGUED, **_ONLY_MOVING}
    if slug not in factories:
        raise ValueError(f"unknown effect '{slug}'; effects are {', '.join(sorted(factories))}")
    return factories[slug](EffectSampler.of(rng, arm, duration_s))


# -- Random parameters of hidden effects whose laws differ in shape from those that ``suggest`` samples ---------------
#
# A discovery that knows an effect by one law meets the same cause here with another law: displacements differ by about
# 5 to 30 %. Sizes are those of ``suggest``.


_Parameters = dict[str, Any]
_Law = Callable[[EffectSampler, _Parameters], _Parameters]


def _one_of(*laws: _Law) -> _Law:
    """Sample one of several laws."""
    return lambda sample, plain: laws[int(sample.rng.integers(len(laws)))](sample, plain)


def _times(factor: float, values: list[float]) -> list[float]:
    return list(map(float, factor * np.array(values)))


def _three_stages(sample: EffectSampler, plain: _Parameters) -> _Parameters:
    stiff, low = plain["stiffness"], sample.uniform(0.1, 0.2)
    return {
        "law": "three_stage",
        "first": _times(sample.uniform(0.45, 0.6), stiff),
        "second": _times(sample.uniform(0.7, 0.85), stiff),
        "third": stiff,
        "first_knee": (low * sample.torques).tolist(),
        "second_knee": (sample.uniform(0.4, 0.6) * sample.torques).tolist(),
    }


def _other_thermal_growth(sample: EffectSampler, plain: _Parameters) -> _Parameters:
    if sample.rng.random() < 0.5:
        return {"law": "saturating", **plain, "limit": sample.uniform(5.0, 12.0)}
    lag = sample.log_uniform(200.0, 500.0)
    return {
        "law": "two_lags",
        **plain,
        "lag": lag,
        "slow_lag": sample.uniform(8.0, 20.0) * lag,
        "slow_share": sample.uniform(0.3, 0.6),
    }


def _other_pedestal_compliance(sample: EffectSampler, plain: _Parameters) -> _Parameters:
    compliance = 1.0 / np.array([*plain["bending"], plain["torsion"]])
    mean = float(np.sqrt(compliance[0] * compliance[1]))
    cross = [float(sample.rng.choice([-1.0, 1.0])) * sample.uniform(0.08, 0.25) * mean for _ in range(3)]
    pivot = [sample.uniform(-0.3, 0.3), sample.uniform(-0.3, 0.3), -plain["height"] * sample.uniform(0.3, 0.8)]
    return {"law": "frame", "pivot": pivot, "direct": compliance.tolist(), "cross": cross}


def _other_pedestal_coupling(sample: EffectSampler, plain: _Parameters) -> _Parameters:
    softer = sample.uniform(0.25, 0.5)  # at small moments, so that the size stays
    return {
        "law": "hardening",
        "bending": softer * plain["bending"],
        "torsion": softer * plain["torsion"],
        "depth": plain["depth"],
        "limit": sample.uniform(40.0, 120.0),
    }


def _other_transmission_error(sample: EffectSampler, plain: _Parameters) -> _Parameters:
    joints = plain["joints"]
    ratio = float(sample.rng.choice([50.0, 80.0, 100.0, 120.0]))
    second = sample.uniform(6.0, 24.0)
    return {
        "mode": "meshing",
        "joints": joints,
        "ratio": [ratio] * len(joints),
        "line": [sample.log_uniform(30e-6, 80e-6) for _ in joints],
        "line_phase": sample.angles(len(joints)),
        "depth": [sample.uniform(0.3, 0.6) for _ in joints],
        "depth_phase": sample.angles(len(joints)),
        "second_cycles": [second] * len(joints),
        "second": [sample.log_uniform(15e-6, 40e-6) for _ in joints],
        "second_phase": sample.angles(len(joints)),
    }


def _other_encoder_eccentricity(sample: EffectSampler, plain: _Parameters) -> _Parameters:
    sizes = np.array(plain["eccentricity"]) / np.array(plain["radius"])
    tilt = [2.0 * float(np.sqrt(sample.uniform(0.08, 0.25) * size)) for size in sizes]
    return {"law": "tilted", **plain, "tilt": tilt, "tilt_phase": sample.angles(len(tilt))}


def _other_joint_axis_wobble(sample: EffectSampler, plain: _Parameters) -> _Parameters:
    sets = ([1.0], [3.0], [4.0], [1.0, 3.0], [2.0, 3.0, 4.0])
    harmonics = sets[int(sample.rng.integers(len(sets)))]
    return {
        "law": "harmonics",
        "joints": plain["joints"],
        "tilt": [sample.log_uniform(25e-6, 60e-6) for _ in plain["joints"]],
        "harmonics": harmonics,
        "shares": [sample.uniform(0.5, 1.0) for _ in harmonics],
        "seed": sample.seed(),
    }


def _other_joint_axis_runout(sample: EffectSampler, plain: _Parameters) -> _Parameters:
    sets = ([3.0], [2.0, 4.0], [1.0, 2.0, 5.0])
    harmonics = sets[int(sample.rng.integers(len(sets)))]
    return {**plain, "harmonics": harmonics, "shares": [sample.uniform(0.5, 1.0) for _ in harmonics]}


def _other_course(sample: EffectSampler, rotation: tuple[float, float]) -> _Parameters:
    twist = {"shift": sample.random_vector(30e-6, 80e-6), "turn": sample.random_vector(*rotation)}
    if sample.rng.random() < 0.5:
        time = sample.uniform(1.2, 2.4) * sample.duration_s
        return {**twist, "law": "sinusoidal", "time": time, "phase": sample.angle()}
    return {**twist, "law": "wandering", "time": sample.uniform(0.5, 1.0) * sample.duration_s, "seed": sample.seed()}


def _creeping(sample: EffectSampler, plain: _Parameters) -> _Parameters:
    share, time = sample.uniform(0.3, 0.6), sample.uniform(0.03, 0.1) * sample.duration_s
    return {"law": "creeping", **plain, "creeping": share, "time_constant": time}


def _other_tracker_angle_error(sample: EffectSampler, plain: _Parameters) -> _Parameters:
    def harmonics() -> list[float]:
        return [sample.log_uniform(3e-6, 10e-6), sample.angle(), sample.log_uniform(2e-6, 6e-6), sample.angle()]

    return {"law": "higher", **plain, "azimuth_higher": harmonics(), "elevation_higher": harmonics()}


_OTHER: Mapping[str, _Law] = {
    "joint_compliance": _one_of(
        _three_stages,
        lambda sample, plain: {
            "law": "stiffening",
            "stiffness": plain["stiffness"],
            "soft_stiffness": _times(sample.uniform(0.35, 0.55), plain["stiffness"]),
            "knee": (sample.uniform(0.2, 0.5) * sample.torques).tolist(),
        },
        lambda sample, plain: {
            "law": "hardening",
            "stiffness": plain["stiffness"],
            # the cubic part takes this share of the largest torque
            "cubic": (sample.uniform(0.3, 0.8) * np.array(plain["stiffness"]) ** 3 / sample.torques**2).tolist(),
        },
    ),
    "payload_compliance": _one_of(
        lambda sample, plain: {"law": "off_centre", **plain, "shift": sample.random_vector(0.03, 0.09)},
        lambda sample, plain: {
            "law": "softening",
            **plain,
            "soft_stiffness": _times(sample.uniform(0.4, 0.65), plain["stiffness"]),
            "knee": (sample.uniform(0.15, 0.4) * sample.torques).tolist(),
        },
    ),
    "link_bending": lambda sample, plain: {
        "law": "shear",
        **plain,
        # of a tube half a metre long: shear adds this share to its deflection
        "shear": [12.0 * value / 0.5**2 / sample.uniform(0.8, 2.0) for value in plain["bending"]],
    },
    "transmission_error": _other_transmission_error,
    "encoder_eccentricity": _other_encoder_eccentricity,
    "backlash": _one_of(
        lambda sample, plain: {
            "law": "warm",
            "play": plain["play"],
            "reach": [sample.log_uniform(0.15, 0.6)] * sample.arm.joints,
            "per_kelvin": sample.uniform(0.01, 0.03),
        },
        lambda sample, plain: {
            "law": "many_plays",
            "play": plain["play"],
            "reach": [sample.log_uniform(0.2, 0.8)] * sample.arm.joints,
        },
    ),
    "friction_windup": lambda sample, plain: (
        {"law": "stribeck", **plain, "rise": sample.uniform(0.4, 1.0), "short": sample.uniform(0.3, 0.9)}
        if sample.rng.random() < 0.5
        else {"law": "root_load", **plain, "typical_load": (0.4 * sample.torques).tolist()}
    ),
    "unsettled_measurement": lambda sample, plain: (
        {"law": "power", **plain, "power": sample.uniform(0.5, 1.2)}
        if sample.rng.random() < 0.5
        else {
            "law": "two_rates",
            **plain,
            "slow_time_constant": _times(sample.uniform(6.0, 15.0), plain["time_constant"]),
            "slow_share": sample.uniform(0.2, 0.5),
        }
    ),
    "joint_axis_wobble": _other_joint_axis_wobble,
    "joint_axis_runout": _other_joint_axis_runout,
    "thermal_growth": _other_thermal_growth,
    "joint_drift": lambda sample, plain: {
        "law": "wandering",
        "drift": plain["drift"],
        "time": sample.uniform(0.7, 1.4) * sample.duration_s,
        "seed": sample.seed(),
    },
    "base_drift": lambda sample, plain: _other_course(sample, (30e-6, 80e-6)),
    "base_step": _creeping,
    "target_slip": _creeping,
    "pedestal_compliance": _other_pedestal_compliance,
    "pedestal_coupling": _other_pedestal_coupling,
    "tracker_scale": lambda sample, plain: {"law": "air", **plain, "per_kelvin": sample.signed_log_uniform(0.5, 2.0)},
    "tracker_angle_error": _other_tracker_angle_error,
    "tracker_distance_offset": lambda sample, plain: {"law": "growing", **plain, "length": sample.uniform(2.0, 8.0)},
    "target_incidence": lambda sample, plain: {
        "law": "power",
        "size": sample.signed_log_uniform(60e-6, 200e-6),
        "power": sample.uniform(2.7, 4.0),
        "dihedral": plain["dihedral"],
    },
    "tracker_drift": lambda sample, plain: _other_course(sample, (8e-6, 25e-6)),
    # shorter than about a hundred stops can resolve
    "workspace_field": lambda sample, plain: {
        **plain,
        "rms": sample.uniform(120e-6, 200e-6),
        "length": sample.uniform(0.25, 0.35),
    },
    "joint_coupling": lambda sample, plain: plain,
    "crosstalk": lambda sample, plain: plain,
}


def suggest_other_law(
    slug: str, rng: np.random.Generator, arm: ArmConfig, duration_s: float = 18000.0
) -> dict[str, Any]:
    """Sample parameters of one effect of ``REALISTIC`` by a law of another shape; otherwise as ``suggest``.

    Outside the catalogue, the field in space has a short length; couplings and crosstalk are those of ``suggest``.

    Raises ``ValueError`` for a slug that has no such law or a duration that is not positive.
    """
    if slug not in _OTHER:
        raise ValueError(f"effect '{slug}' has no other law; those that have are {', '.join(sorted(_OTHER))}")
    plain = suggest(slug, rng, arm, duration_s)
    if slug == "joint_compliance":
        plain = {"stiffness": plain["stiffness"]}
    return _OTHER[slug](EffectSampler.of(rng, arm, duration_s), plain)
