"""Realistic parameters of hidden effects, drawn at random, so that blind trials can be made of them.

Sizes are those that strain-wave drives, encoders, pedestals and trackers of this class are given in catalogues or
estimated to have, for an arm with the reach and weight of a UR10; for other arms they are scaled by torque or length.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.plant.config import ArmConfig, Array
from drivers.plant.effects.joint_axis_wobble import tilt_of_two_lobes
from drivers.plant.mechanism import gravity_torques

_POSES = 256
_UR10_REACH_M = 1.39


@dataclass(frozen=True, eq=False)
class _Cell:
    """What sizes depend on: the random stream, the arm, how long the run lasts [s], the arm's torques and reach."""

    rng: np.random.Generator
    arm: ArmConfig
    duration_s: float
    torques: Array  # (N,) the largest of gravity on each joint of the unloaded arm [Nm]
    reach: float  # longest way from joint 1 to the SMR [m], roughly

    def between(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def about(self, low: float, high: float) -> float:
        """Between two positive sizes, evenly in the logarithm."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def either(self, low: float, high: float) -> float:
        """As ``about``, of either sign."""
        return float(self.rng.choice([-1.0, 1.0])) * self.about(low, high)

    def angle(self) -> float:
        return self.between(0.0, 2.0 * np.pi)

    def angles(self, count: int) -> list[float]:
        return [self.angle() for _ in range(count)]

    def vector(self, low: float, high: float) -> list[float]:
        """In any direction, its length between two."""
        way = self.rng.standard_normal(3)
        found: list[float] = (way / np.linalg.norm(way) * self.about(low, high)).tolist()
        return found

    def some_joints(self) -> list[int]:
        """Two to four joints, counted from 1; at least two of those with long lever arms, if the arm has as many."""
        joints = self.arm.joints
        long = min(joints, 3)
        count = min(int(self.rng.integers(2, 5)), joints)
        first = self.rng.permutation(long)[: min(2, long)]
        rest = self.rng.permutation(np.setdiff1d(np.arange(joints), first))
        chosen = np.concatenate([first, rest])[:count] + 1
        return sorted(int(joint) for joint in chosen)

    def each(self, low: float, high: float) -> list[float]:
        return [self.about(low, high) for _ in range(self.arm.joints)]


def _drive_stiffness(cell: _Cell) -> list[float]:
    """Drives are chosen for the torque they bear: under the largest they wind up by 1 to 2.2 mrad.

    UR10, shoulder: 5.5e4 to 1.2e5 Nm/rad. Wrist drives are larger than their torque asks for.
    """
    borne = np.maximum(cell.torques, 0.15 * cell.torques.max())
    borne[0] = max(borne[0], cell.torques.max())
    windup = cell.about(1.0e-3, 2.2e-3) * np.exp(0.2 * cell.rng.standard_normal(cell.arm.joints))
    found: list[float] = (borne / windup).tolist()
    return found


def _joint_compliance(cell: _Cell) -> dict[str, Any]:
    stiffness = _drive_stiffness(cell)
    if cell.rng.random() < 0.7:
        return {"stiffness": stiffness}
    knee = np.maximum(cell.between(0.15, 0.45) * cell.torques, 0.5)
    return {
        "stiffness": stiffness,
        "soft_stiffness": (cell.between(0.65, 0.85) * np.array(stiffness)).tolist(),
        "knee": knee.tolist(),
    }


def _payload_compliance(cell: _Cell) -> dict[str, Any]:
    return {"stiffness": _drive_stiffness(cell)}


def _link_bending(cell: _Cell) -> dict[str, Any]:
    lengths = np.hypot(cell.arm.rows[:, 1], cell.arm.rows[:, 2])
    links = sorted(int(i) + 1 for i in np.argsort(lengths)[::-1][:2])
    size = cell.reach / _UR10_REACH_M
    bending = [1e5 * size * cell.about(0.7, 1.5) for _ in links]
    return {"links": links, "bending": bending, "torsion": [0.77 * each for each in bending]}


def _transmission_error(cell: _Cell) -> dict[str, Any]:
    joints = cell.some_joints()
    count = len(joints)
    if cell.rng.random() < 0.4:
        return {
            "mode": "curve",
            "joints": joints,
            "rms": [cell.about(20e-6, 200e-6) for _ in joints],
            "seed": int(cell.rng.integers(2**31)),
            "lowest": int(cell.rng.integers(4, 8)),
            "highest": int(cell.rng.integers(30, 46)),
        }
    which = cell.rng.choice(["output", "generator", "both"])
    ratio = float(cell.rng.choice([80.0, 100.0, 101.0, 120.0, 160.0]))
    off = np.zeros(count)
    once = off if which == "output" else ratio * np.array([cell.about(15e-6, 60e-6) for _ in joints])
    twice = off if which == "output" else np.array([cell.about(15e-6, 60e-6) for _ in joints])
    output = off if which == "generator" else np.array([cell.about(20e-6, 60e-6) for _ in joints])
    return {
        "mode": "lines",
        "joints": joints,
        "ratio": [ratio] * count,
        "eccentric": once.tolist(),
        "eccentric_phase": cell.angles(count),
        "coupling_slant": (2.0 * np.arctan(np.sqrt(ratio * twice))).tolist(),
        "coupling_phase": cell.angles(count),
        "output_slant": (2.0 * np.arctan(np.sqrt(output))).tolist(),
        "output_phase": cell.angles(count),
    }


def _encoder_eccentricity(cell: _Cell) -> dict[str, Any]:
    joints = cell.some_joints()
    return {
        "joints": joints,
        "eccentricity": [cell.about(1e-6, 3e-6) for _ in joints],
        "radius": [0.025] * len(joints),
        "phase": cell.angles(len(joints)),
    }


def _backlash(cell: _Cell) -> dict[str, Any]:
    values: dict[str, Any] = {"play": cell.each(50e-6, 140e-6)}
    if cell.rng.random() < 0.3:
        values["reach"] = [cell.about(0.05, 0.4)] * cell.arm.joints
    return values


def _friction_windup(cell: _Cell) -> dict[str, Any]:
    stiffness = np.array(_drive_stiffness(cell))
    # about 5 Nm and 5 % of the load at a shoulder of 122 Nm
    friction = [5.0 * cell.about(0.5, 1.5) * each / 8e4 for each in stiffness]
    return {
        "friction": friction,
        "load_friction": cell.each(0.03, 0.1),
        "stiffness": stiffness.tolist(),
    }


def _unsettled_measurement(cell: _Cell) -> dict[str, Any]:
    return {
        "fraction": cell.each(6e-5, 1.6e-4),
        "time_constant": [cell.about(2.0, 8.0)] * cell.arm.joints,
    }


def _joint_axis_wobble(cell: _Cell) -> dict[str, Any]:
    joints = cell.some_joints()
    radius = 0.06 * cell.reach / _UR10_REACH_M
    two = [cell.about(20e-6, 50e-6) * radius / tilt_of_two_lobes() for _ in joints]
    return {
        "joints": joints,
        "radius": [radius] * len(joints),
        "two_lobes": two,
        "three_lobes": [cell.between(0.0, 0.25) * each for each in two],
        "phase": cell.angles(len(joints)),
    }


def _thermal_growth(cell: _Cell) -> dict[str, Any]:
    return {
        "expansion": cell.between(20e-6, 25e-6),
        "share": cell.between(0.6, 1.0),
        "lag": cell.about(300.0, 1800.0),
        "motor": cell.between(0.5e-6, 2.5e-6) * cell.reach / _UR10_REACH_M,
    }


def _joint_drift(cell: _Cell) -> dict[str, Any]:
    drift = [cell.either(30e-6, 80e-6) for _ in range(cell.arm.joints)]
    return {"drift": drift, "time_constant": [cell.between(0.12, 0.4) * cell.duration_s] * cell.arm.joints}


def _course(cell: _Cell) -> tuple[str, float, float]:
    """Law, its time, and how far it has gone when the run is over."""
    law = str(cell.rng.choice(["linear", "exponential", "creep"]))
    if law == "linear":
        return law, cell.duration_s, 1.0
    if law == "exponential":
        time = cell.between(0.12, 0.4) * cell.duration_s
        return law, time, float(-np.expm1(-cell.duration_s / time))
    time = cell.about(0.03, 0.15) * cell.duration_s
    return law, time, float(np.log1p(cell.duration_s / time))


def _drift(cell: _Cell, turn: tuple[float, float]) -> dict[str, Any]:
    law, time, gone = _course(cell)
    return {
        "shift": [each / gone for each in cell.vector(30e-6, 80e-6)],
        "turn": [each / gone for each in cell.vector(*turn)],
        "law": law,
        "time": time,
    }


def _base_drift(cell: _Cell) -> dict[str, Any]:
    return _drift(cell, (30e-6, 80e-6))


def _tracker_drift(cell: _Cell) -> dict[str, Any]:
    return _drift(cell, (8e-6, 25e-6))


def _base_step(cell: _Cell) -> dict[str, Any]:
    return {
        "shift": cell.vector(20e-6, 60e-6),
        "turn": cell.vector(20e-6, 60e-6),
        "time": cell.between(0.2, 0.8) * cell.duration_s,
    }


def _target_slip(cell: _Cell) -> dict[str, Any]:
    return {"shift": cell.vector(40e-6, 150e-6), "time": cell.between(0.2, 0.8) * cell.duration_s}


def _pedestal_compliance(cell: _Cell) -> dict[str, Any]:
    stiffness = cell.torques.max() / cell.about(45e-6, 90e-6)
    return {
        "height": cell.between(0.4, 1.0),
        "bending": [float(stiffness * cell.between(0.85, 1.2)) for _ in range(2)],
        "torsion": float(1.5 * stiffness),
    }


def _pedestal_coupling(cell: _Cell) -> dict[str, Any]:
    bending = cell.about(1.3e6, 3e6)
    return {"bending": bending, "torsion": bending * cell.between(0.6, 1.2), "depth": cell.between(0.2, 0.8)}


def _tracker_scale(cell: _Cell) -> dict[str, Any]:
    return {"ppm": cell.either(2.0, 10.0)}


def _tracker_angle_error(cell: _Cell) -> dict[str, Any]:
    def circle() -> list[float]:
        # second order s^2 / 4
        return [cell.about(8e-6, 20e-6), cell.angle(), 2.0 * float(np.sqrt(cell.about(6e-6, 20e-6))), cell.angle()]

    return {"azimuth": circle(), "elevation": circle(), "transit": cell.either(5e-6, 15e-6)}


def _tracker_distance_offset(cell: _Cell) -> dict[str, Any]:
    return {"offset": cell.either(8e-6, 30e-6)}


def _target_incidence(cell: _Cell) -> dict[str, Any]:
    # a plate so thick that the error is this large where the reflector just still answers
    index, cosine = 1.51, np.cos(cell.arm.smr_acceptance)
    path = np.sqrt(index**2 - 1.0 + cosine**2) - cosine - (index - 1.0)
    thickness = cell.about(30e-6, 70e-6) / max(float(path), 0.01)
    return {"thickness": thickness, "index": index, "dihedral": cell.either(1e-6, 3e-6)}


def _dress_pack(cell: _Cell) -> dict[str, Any]:
    mix = cell.between(0.4, 1.2)
    return {
        "torque": cell.either(4.0, 9.0) * cell.torques.max() / 122.0,
        "stiffness": 8e4 * cell.torques.max() / 122.0,
        "first": 1.0,
        "second": float(cell.rng.choice([-1.0, 1.0])) * mix,
        "centre": cell.between(-0.8, 0.8),
        "width": cell.between(0.3, 0.9),
    }


def _crosstalk(cell: _Cell) -> dict[str, Any]:
    return {"amplitude": cell.either(150e-6, 350e-6), "phase": cell.angle()}


def _base_sway(cell: _Cell) -> dict[str, Any]:
    shift = cell.vector(30e-6, 70e-6)
    return {"shift": shift, "period": cell.between(1500.0, 4500.0), "phase": cell.angle()}


def _tool_sag(cell: _Cell) -> dict[str, Any]:
    return {"shift": cell.vector(60e-6, 140e-6)}


def _wrist_cable(cell: _Cell) -> dict[str, Any]:
    lever = max(float(np.hypot(*cell.arm.smr_offset[:2])), 0.02)
    return {"amplitude": cell.either(40e-6, 90e-6) / lever, "phase": cell.angle()}


def _draught(cell: _Cell) -> dict[str, Any]:
    return {"angle": cell.either(9e-6, 20e-6), "period": cell.between(1200.0, 3600.0), "phase": cell.angle()}


_KNOWN: dict[str, Callable[[_Cell], dict[str, Any]]] = {
    "joint_compliance": _joint_compliance,
    "payload_compliance": _payload_compliance,
    "link_bending": _link_bending,
    "transmission_error": _transmission_error,
    "encoder_eccentricity": _encoder_eccentricity,
    "backlash": _backlash,
    "friction_windup": _friction_windup,
    "unsettled_measurement": _unsettled_measurement,
    "joint_axis_wobble": _joint_axis_wobble,
    "thermal_growth": _thermal_growth,
    "joint_drift": _joint_drift,
    "base_drift": _base_drift,
    "base_step": _base_step,
    "target_slip": _target_slip,
    "pedestal_compliance": _pedestal_compliance,
    "pedestal_coupling": _pedestal_coupling,
    "tracker_scale": _tracker_scale,
    "tracker_angle_error": _tracker_angle_error,
    "tracker_distance_offset": _tracker_distance_offset,
    "target_incidence": _target_incidence,
    "tracker_drift": _tracker_drift,
}
_PECULIAR: dict[str, Callable[[_Cell], dict[str, Any]]] = {
    "dress_pack": _dress_pack,
    "crosstalk": _crosstalk,
    "base_sway": _base_sway,
    "tool_sag": _tool_sag,
    "wrist_cable": _wrist_cable,
    "draught": _draught,
}

REALISTIC: tuple[str, ...] = tuple(_KNOWN)
"""Effects that robots, trackers and pedestals are known to have."""

OUTSIDE: tuple[str, ...] = tuple(_PECULIAR)
"""Laws that no catalogue of them holds."""


def suggest(slug: str, rng: np.random.Generator, arm: ArmConfig, duration_s: float = 18000.0) -> dict[str, Any]:
    """Parameters of one effect at a realistic size, as ``ArmConfig.effects`` takes them: numbers, words and lists.

    Parameters
    ----------
    slug : str
        One of ``REALISTIC`` or ``OUTSIDE``.
    rng : numpy.random.Generator
        Draws joints, signs, phases, sizes and onsets; the same state gives the same parameters.
    arm : ArmConfig
        Whose reach, weight and SMR scale the sizes.
    duration_s : float
        How long the run lasts [s]: onsets and time constants lie within it.

    Raises ``ValueError`` for a slug that does not exist or a duration that is not positive.
    """
    makers = _KNOWN | _PECULIAR
    if slug not in makers:
        raise ValueError(f"there is no effect '{slug}'; effects are {', '.join(sorted(makers))}")
    if not 0.0 < duration_s < np.inf:
        raise ValueError(f"duration_s must be a positive time, not {duration_s:g}")
    poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (_POSES, arm.joints))
    torques = np.maximum(np.abs(gravity_torques(arm, poses)).max(axis=0), 1e-3)
    reach = float(np.hypot(arm.rows[:, 1], arm.rows[:, 2])[1:].sum())
    return makers[slug](_Cell(rng, arm, float(duration_s), torques, reach))
