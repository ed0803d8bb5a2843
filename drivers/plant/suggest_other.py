"""Random parameters of hidden effects whose laws differ in shape from those that ``suggest`` draws.

A discovery that knows an effect by one law meets the same cause here with another law: displacements differ by about 5
to 30 %. Sizes are those of ``suggest``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from drivers.plant.config import ArmConfig
from drivers.plant.suggest import Draw, suggest

_Parameters = dict[str, Any]


def _some(draw: Draw, *laws: Callable[[Draw, _Parameters], _Parameters]) -> Callable[[Draw, _Parameters], _Parameters]:
    """Draw one of several laws."""
    return laws[int(draw.rng.integers(len(laws)))]


def _times(factor: float, values: list[float]) -> list[float]:
    found: list[float] = (factor * np.array(values)).tolist()
    return found


# -- elastic and thermal effects ---------------------------------------------------------------------------------------


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


def _stiffening(draw: Draw, plain: _Parameters) -> _Parameters:
    return {
        "law": "stiffening",
        "stiffness": plain["stiffness"],
        "soft_stiffness": _times(draw.uniform(0.35, 0.55), plain["stiffness"]),
        "knee": (draw.uniform(0.2, 0.5) * draw.torques).tolist(),
    }


def _hardening(draw: Draw, plain: _Parameters) -> _Parameters:
    stiff = np.array(plain["stiffness"])
    # the cubic part takes this share of the largest torque
    cubic = draw.uniform(0.3, 0.8) * stiff**3 / draw.torques**2
    return {"law": "hardening", "stiffness": plain["stiffness"], "cubic": cubic.tolist()}


def _joint_compliance(draw: Draw, plain: _Parameters) -> _Parameters:
    return _some(draw, _three_stages, _stiffening, _hardening)(draw, plain)


def _off_centre(draw: Draw, plain: _Parameters) -> _Parameters:
    return {"law": "off_centre", **plain, "shift": draw.random_vector(0.03, 0.09)}


def _softening(draw: Draw, plain: _Parameters) -> _Parameters:
    return {
        "law": "softening",
        **plain,
        "soft_stiffness": _times(draw.uniform(0.4, 0.65), plain["stiffness"]),
        "knee": (draw.uniform(0.15, 0.4) * draw.torques).tolist(),
    }


def _payload_compliance(draw: Draw, plain: _Parameters) -> _Parameters:
    return _some(draw, _off_centre, _softening)(draw, plain)


def _link_bending(draw: Draw, plain: _Parameters) -> _Parameters:
    # of a tube half a metre long: shear adds this share to its deflection
    shear = [12.0 * value / 0.5**2 / draw.uniform(0.8, 2.0) for value in plain["bending"]]
    return {"law": "shear", **plain, "shear": shear}


def _thermal_growth(draw: Draw, plain: _Parameters) -> _Parameters:
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


def _joint_drift(draw: Draw, plain: _Parameters) -> _Parameters:
    time = draw.uniform(0.7, 1.4) * draw.duration_s
    return {"law": "wandering", "drift": plain["drift"], "time": time, "seed": draw.seed()}


def _pedestal_compliance(draw: Draw, plain: _Parameters) -> _Parameters:
    compliance = 1.0 / np.array([*plain["bending"], plain["torsion"]])
    mean = float(np.sqrt(compliance[0] * compliance[1]))
    cross = [float(draw.rng.choice([-1.0, 1.0])) * draw.uniform(0.08, 0.25) * mean for _ in range(3)]
    pivot = [draw.uniform(-0.3, 0.3), draw.uniform(-0.3, 0.3), -plain["height"] * draw.uniform(0.3, 0.8)]
    return {"law": "frame", "pivot": pivot, "direct": compliance.tolist(), "cross": cross}


def _pedestal_coupling(draw: Draw, plain: _Parameters) -> _Parameters:
    softer = draw.uniform(0.25, 0.5)  # at small moments, so that the size stays
    return {
        "law": "hardening",
        "bending": softer * plain["bending"],
        "torsion": softer * plain["torsion"],
        "depth": plain["depth"],
        "limit": draw.uniform(40.0, 120.0),
    }


# -- gears, bearings, encoders, friction -------------------------------------------------------------------------------


def _transmission_error(draw: Draw, plain: _Parameters) -> _Parameters:
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


def _encoder_eccentricity(draw: Draw, plain: _Parameters) -> _Parameters:
    sizes = np.array(plain["eccentricity"]) / np.array(plain["radius"])
    tilt = [2.0 * float(np.sqrt(draw.uniform(0.08, 0.25) * size)) for size in sizes]
    return {"law": "tilted", **plain, "tilt": tilt, "tilt_phase": draw.angles(len(tilt))}


def _warm_play(draw: Draw, plain: _Parameters) -> _Parameters:
    reach = [draw.log_uniform(0.15, 0.6)] * draw.arm.joints
    return {"law": "warm", "play": plain["play"], "reach": reach, "per_kelvin": draw.uniform(0.01, 0.03)}


def _many_plays(draw: Draw, plain: _Parameters) -> _Parameters:
    return {"law": "many_plays", "play": plain["play"], "reach": [draw.log_uniform(0.2, 0.8)] * draw.arm.joints}


def _backlash(draw: Draw, plain: _Parameters) -> _Parameters:
    return _some(draw, _warm_play, _many_plays)(draw, plain)


def _friction_windup(draw: Draw, plain: _Parameters) -> _Parameters:
    if draw.rng.random() < 0.5:
        return {"law": "stribeck", **plain, "rise": draw.uniform(0.4, 1.0), "short": draw.uniform(0.3, 0.9)}
    return {"law": "root_load", **plain, "typical_load": (0.4 * draw.torques).tolist()}


def _unsettled_measurement(draw: Draw, plain: _Parameters) -> _Parameters:
    if draw.rng.random() < 0.5:
        return {"law": "power", **plain, "power": draw.uniform(0.5, 1.2)}
    slow = _times(draw.uniform(6.0, 15.0), plain["time_constant"])
    return {"law": "two_rates", **plain, "slow_time_constant": slow, "slow_share": draw.uniform(0.2, 0.5)}


def _joint_axis_wobble(draw: Draw, plain: _Parameters) -> _Parameters:
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


def _joint_axis_runout(draw: Draw, plain: _Parameters) -> _Parameters:
    sets = ([3.0], [2.0, 4.0], [1.0, 2.0, 5.0])
    harmonics = sets[int(draw.rng.integers(len(sets)))]
    return {**plain, "harmonics": harmonics, "shares": [draw.uniform(0.5, 1.0) for _ in harmonics]}


# -- base, tracker, target ---------------------------------------------------------------------------------------------


def _course(draw: Draw, shift: list[float], turn: list[float]) -> _Parameters:
    if draw.rng.random() < 0.5:
        return {
            "shift": shift,
            "turn": turn,
            "law": "sinusoidal",
            "time": draw.uniform(1.2, 2.4) * draw.duration_s,
            "phase": draw.angle(),
        }
    time = draw.uniform(0.5, 1.0) * draw.duration_s
    return {"shift": shift, "turn": turn, "law": "wandering", "time": time, "seed": draw.seed()}


def _base_drift(draw: Draw, plain: _Parameters) -> _Parameters:
    return _course(draw, draw.random_vector(30e-6, 80e-6), draw.random_vector(30e-6, 80e-6))


def _tracker_drift(draw: Draw, plain: _Parameters) -> _Parameters:
    return _course(draw, draw.random_vector(30e-6, 80e-6), draw.random_vector(8e-6, 25e-6))


def _creeping(draw: Draw, plain: _Parameters) -> _Parameters:
    return {
        "law": "creeping",
        **plain,
        "creeping": draw.uniform(0.3, 0.6),
        "time_constant": draw.uniform(0.03, 0.1) * draw.duration_s,
    }


def _tracker_scale(draw: Draw, plain: _Parameters) -> _Parameters:
    return {"law": "air", **plain, "per_kelvin": draw.signed_log_uniform(0.5, 2.0)}


def _tracker_distance_offset(draw: Draw, plain: _Parameters) -> _Parameters:
    return {"law": "growing", **plain, "length": draw.uniform(2.0, 8.0)}


def _tracker_angle_error(draw: Draw, plain: _Parameters) -> _Parameters:
    def harmonics() -> list[float]:
        return [draw.log_uniform(3e-6, 10e-6), draw.angle(), draw.log_uniform(2e-6, 6e-6), draw.angle()]

    return {"law": "higher", **plain, "azimuth_higher": harmonics(), "elevation_higher": harmonics()}


def _target_incidence(draw: Draw, plain: _Parameters) -> _Parameters:
    size = draw.signed_log_uniform(60e-6, 200e-6)
    return {"law": "power", "size": size, "power": draw.uniform(2.7, 4.0), "dihedral": plain["dihedral"]}


def _workspace_field(draw: Draw, plain: _Parameters) -> _Parameters:
    # shorter than about a hundred stops can resolve
    return {**plain, "rms": draw.uniform(120e-6, 200e-6), "length": draw.uniform(0.25, 0.35)}


def _as_suggested(draw: Draw, plain: _Parameters) -> _Parameters:
    return plain


_OTHER: dict[str, Callable[[Draw, _Parameters], _Parameters]] = {
    "joint_compliance": _joint_compliance,
    "payload_compliance": _payload_compliance,
    "link_bending": _link_bending,
    "transmission_error": _transmission_error,
    "encoder_eccentricity": _encoder_eccentricity,
    "backlash": _backlash,
    "friction_windup": _friction_windup,
    "unsettled_measurement": _unsettled_measurement,
    "joint_axis_wobble": _joint_axis_wobble,
    "joint_axis_runout": _joint_axis_runout,
    "thermal_growth": _thermal_growth,
    "joint_drift": _joint_drift,
    "base_drift": _base_drift,
    "base_step": _creeping,
    "target_slip": _creeping,
    "pedestal_compliance": _pedestal_compliance,
    "pedestal_coupling": _pedestal_coupling,
    "tracker_scale": _tracker_scale,
    "tracker_angle_error": _tracker_angle_error,
    "tracker_distance_offset": _tracker_distance_offset,
    "target_incidence": _target_incidence,
    "tracker_drift": _tracker_drift,
    "workspace_field": _workspace_field,
    "joint_coupling": _as_suggested,
    "crosstalk": _as_suggested,
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
