"""Simulated readings for blind trials: random order, and factors varied so that effects can be told apart.

Size of a hidden effect: the part that geometry cannot absorb.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.planning.planned_stops import PlannedStops
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.estimation.calibration.calibrate import profile_splits
from cellapp.estimation.calibration.identification import start_from_nominal
from cellapp.estimation.calibration.parameters import auto_set
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Arm, Profile
from cellapp.robot.kinematics.chain import Geometry, JointAngles, jacobian
from cellapp.robot.kinematics.transforms import Array, quaternions_of
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import nominal_arm
from drivers.plant import Plant
from drivers.plant.plant import Conditions

_DWELLS_S = (1.0, 8.0)
"""Range of the rest before a measurement [s], sampled log-uniformly."""
_HEAVY_SHARE = 0.8
"""Heavy payload as a share of the rated one."""
_RATED_KG = {"UR3": 3.0, "UR5": 5.0, "UR10": 10.0}
"""Rated payloads, from the makers' data sheets."""
_JOINT_RISE_K = (6.0, 16.0)
"""Range of the joints' final temperature above the air [K]."""
_WARM_UP_S = 3000.0
"""Time constant of a joint's warming [s]."""
_AIR_PERIODS_S = (4.0e3, 1.5e4, 4.0e4)
"""Periods of the air temperature [s]: ventilation, sun, day."""
_AIR_AMPLITUDE_K = 1.5


@dataclass(frozen=True)
class TrialNoise:
    """Noise model of the readings.

    ``gaussian``, or ``heavy`` (Student's t with 4 degrees of freedom, scaled to the same standard deviation);
    ``repeatability`` is the standard deviation of the joints [rad].
    """

    kind: str = "gaussian"
    repeatability: float = 0.0


def with_hidden(profile: Profile, effects: Mapping[str, Mapping[str, Mapping[str, Any]]], seed: int) -> Profile:
    """Return the profile with other hidden effects (arm -> effect -> parameters) and a true cell sampled by
    ``seed``."""
    assert profile.plant is not None
    plain = {arm: {slug: dict(values) for slug, values in each.items()} for arm, each in effects.items()}
    settings = profile.plant.model_copy(update={"effects": plain, "seed": seed})
    return profile.model_copy(update={"plant": settings, "seed": seed})


DURATION_S = 18000.0
"""Time in which a run is measured: that of 400 stops of the real cell."""
_PAYLOAD_BLOCKS = 4
"""Parts of a run, in turn with the profile's and the heavy payload: it is changed by hand, so it changes seldom."""


def _visits(
    profile: Profile, plan: Mapping[str, Array] | PlannedStops, order: NDArray[np.intp]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return joint positions and last motions in the order of the visits, arm -> (n, N) [rad] each.

    A designed plan is visited as planned; other stops in ``order``, straight from stop to stop.
    """
    homes = home_positions(profile)
    q = dict(plan.q) if isinstance(plan, PlannedStops) else {name: rows[order] for name, rows in plan.items()}
    step = {name: np.diff(np.vstack([homes[name], rows]), axis=0) for name, rows in q.items()}
    if isinstance(plan, PlannedStops):
        step = {
            name: np.where(np.isnan(plan.approach_from[name]), step[name], q[name] - plan.approach_from[name])
            for name in q
        }
    return q, step


def blind_readings(
    profile: Profile, plan: Mapping[str, Array] | PlannedStops, seed: int, noise: TrialNoise | None = None
) -> dict[str, Readings]:
    """Simulate the readings of all arms at the stops of ``plan``.

    Plain stops (name -> (n, N) [rad]) are visited in an order sampled by ``seed``, straight from stop to stop; a
    designed plan in its own order and with its approaches. The rest before a measurement varies from 1 to 8 s, the
    payload alternates in blocks between the profile's and 80 % of the rated one, and joints warm up.
    """
    noise = noise or TrialNoise()
    rng = np.random.default_rng([seed, 0xB11D])
    plant = build_plant(profile)
    n = len(plan) if isinstance(plan, PlannedStops) else len(next(iter(plan.values())))
    at, steps = _visits(profile, plan, rng.permutation(n))
    time_s, dwell_s, air_c = _sampled_conditions(profile, n, DURATION_S, rng)
    loads_kg = _loads_kg(profile, n, _PAYLOAD_BLOCKS)
    readings = {}
    for place, (name, q) in enumerate(at.items()):
        step = steps[name]
        rise = rng.uniform(*_JOINT_RISE_K, q.shape[1]) * -np.expm1(-time_s[:, None] / _WARM_UP_S)
        joints_c = air_c[:, None] + rise
        stopped = q + noise.repeatability * rng.standard_normal(q.shape)
        conditions = conditions_at(name, at, step, time_s, dwell_s, loads_kg[name], joints_c, air_c)
        conditions["other_payloads"] = {other: loads_kg[other] for other in loads_kg if other != name}
        exact = plant.smr_positions(name, stopped, **conditions)
        noise_rng = np.random.default_rng([seed, place, 0x401])
        points, covariance = plant.measure_positions(exact, noise_rng)
        if noise.kind == "heavy":
            points = _heavy_tailed(exact, covariance, noise_rng)
        readings[name] = replace(
            readings_at(q, conditions, points, covariance),
            temperature_c=air_c + 0.05 * noise_rng.standard_normal(n),
            joint_temperature_c=np.round(joints_c + 0.1 * noise_rng.standard_normal(q.shape), 2),
            **_measured_orientation(profile, plant, name, stopped, conditions, [seed, place, 0x6D]),
        )
    splits, _ = profile_splits(profile, readings)
    return {name: replace(arm, split=splits[name]) for name, arm in readings.items()}


def conditions_at(
    name: str,
    q: Mapping[str, Array],
    step: Array,
    time_s: Array,
    dwell_s: Array,
    load_kg: Array,
    joints_c: Array,
    air_c: Array,
) -> Conditions:
    """Return the plant's conditions at the stops of an arm, all arms at ``q`` (n, N) [rad] each."""
    return {
        "approach": np.sign(step),
        "others": {other: rows for other, rows in q.items() if other != name},
        "time_s": time_s,
        "last_step": step,
        "since_rest_s": dwell_s,
        "payload": load_kg,
        "joints_c": joints_c,
        "air_c": air_c,
    }


def readings_at(q: Array, conditions: Conditions, p_M: Array, covariance_M: Array) -> Readings:
    """Return points (n, 3) [m] that were measured under these conditions as readings."""
    return Readings(
        configuration=np.arange(len(q)),
        time_s=np.asarray(conditions["time_s"]),
        q=q,
        approach=np.asarray(conditions["approach"], dtype=np.int8),
        p_M=p_M,
        payload_kg=conditions["payload"],
        temperature_c=conditions["air_c"],
        joint_temperature_c=conditions["joints_c"],
        step=conditions["last_step"],
        dwell_s=conditions["since_rest_s"],
        covariance_M=covariance_M,
    )


def _measured_orientation(
    profile: Profile, plant: Plant, name: str, q: Array, conditions: Conditions, seed: Sequence[int]
) -> dict[str, Any]:
    """Simulate the orientations of a 6-D probe and their uncertainty; empty for an arm without one."""
    probe = profile.arms[name].smr.probe
    if probe is None:
        return {}
    error = Rotation.from_rotvec(probe.sigma * np.random.default_rng(seed).standard_normal((len(q), 3)))
    return {
        "quaternion_M": quaternions_of(error.as_matrix() @ plant.probe_rotations(name, q, **conditions)),
        "sigma_rad": np.full(len(q), probe.sigma),
    }


def _sampled_conditions(
    profile: Profile, n: int, duration_s: float, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Sample times [s], rests before the measurement [s] and air temperatures [degC] of n stops, each (n,)."""
    time_s = np.sort(rng.uniform(0.0, duration_s, n))
    dwell_s = np.exp(rng.uniform(math.log(_DWELLS_S[0]), math.log(_DWELLS_S[1]), n))
    phases = rng.uniform(0.0, 2.0 * np.pi, len(_AIR_PERIODS_S))
    waves = np.sin(2.0 * np.pi * time_s[:, None] / np.array(_AIR_PERIODS_S) + phases)
    assert profile.plant is not None
    return time_s, dwell_s, profile.plant.temperature + _AIR_AMPLITUDE_K * waves.mean(axis=1)


def _loads_kg(profile: Profile, n: int, blocks: int) -> dict[str, Array]:
    """Return the payloads (n,) [kg] of every arm: alternating blocks of the profile's and the heavy one."""
    heavy = (np.arange(n) * blocks // n) % 2 == 1
    return {
        name: np.where(heavy, _HEAVY_SHARE * _rated_kg(arm), arm.payload.mass) for name, arm in profile.arms.items()
    }


def _heavy_tailed(exact: Array, covariance: Array, rng: np.random.Generator) -> Array:
    """Add noise of the given covariance (n, 3, 3) [m^2], sampled from Student's t, to points (n, 3) [m]."""
    t = rng.standard_t(4, exact.shape) / np.sqrt(2.0)
    return np.asarray(exact + np.einsum("nab,nb->na", np.linalg.cholesky(covariance), t))


def _rated_kg(arm: Arm) -> float:
    return _RATED_KG.get(arm.type.model.strip().upper().removesuffix("E"), 5.0)


def beyond_geometry(arm: Arm, q: Array, p_M: Array, moved: Array) -> Array:
    """Return the part of displacements ``moved`` (n, 3) [m] that the identifiable geometry cannot absorb.

    ``q`` (n, N) [rad] are the stops, ``p_M`` (n, 3) [m] the SMR positions without the effect. The nominal arm,
    registered to the tracker, is linearized; the part is orthogonal to the columns of its Jacobian.
    """
    nominal = _registered(arm, q, p_M)
    columns = auto_set(nominal, q).columns
    _, J = jacobian(nominal, JointAngles.of(q), columns)
    basis, _ = np.linalg.qr(J.transpose(0, 2, 1).reshape(-1, len(columns)))
    y = moved.T.ravel()
    return np.asarray((y - basis @ (basis.T @ y)).reshape(3, -1).T)


def registered_model(profile: Profile, name: str, q: Array, p_M: Array) -> ArmModel:
    """Return an arm's nominal model, its base registered to SMR positions ``p_M`` (n, 3) [m] at ``q`` (n, N)."""
    geometry = _registered(profile.arms[name], q, p_M)
    return ArmModel.of(profile, name, geometry, geometry)


def _registered(arm: Arm, q: Array, p_M: Array) -> Geometry:
    return start_from_nominal(nominal_arm(arm), q, p_M, tool_unknown=arm.smr.offset == "unknown")
