"""Simulated cells that programs draw by a seed, their readings as if a plan were collected, and their calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.estimation.calibration.calibrate import profile_splits
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array, quaternions_of
from drivers.plant import Plant
from tests.evidence.skeleton import ROOT
from tests.series import readings_at
from tests.sure import sure
from tests.twin import altered

TWIN = ROOT / "profiles" / "twin.yaml"
_STIFFNESS, _PLAY, _CURVE = (6e4, 3e4), 1e-4, 1e-4
"""Hidden effects of the mix: stiffness of every joint of two arms in turn [Nm/rad], play and rms of the gears' curves
[rad]; sizes as in catalogues of strain-wave gears and in measured arms of this class."""


def sampled_cell(profile: Profile, seed: int, *, mix: bool = False) -> Profile:
    """Return the profile of a simulated cell; ``seed`` draws its true geometry, plan and splits.

    ``mix`` adds hidden effects of the arms themselves, with curves drawn by ``seed``.
    """
    profile = _with_mix(profile, seed) if mix else profile
    return altered(profile, seed=seed, plant={"seed": seed})


def _with_mix(profile: Profile, seed: int) -> Profile:
    hidden = {}
    for place, (name, arm) in enumerate(profile.arms.items()):
        count = len(arm.type.joints)
        sag: dict[str, object] = {"stiffness": [_STIFFNESS[place % 2]] * count}
        if place % 2:
            hidden[name] = {"joint_compliance": sag, "backlash": {"play": [_PLAY] * count}}
        else:
            curves = {"joints": list(range(1, count)), "rms": [_CURVE] * (count - 1), "lowest": 2, "highest": 30}
            hidden[name] = {"joint_compliance": sag, "transmission_error": {"mode": "curve", "seed": seed, **curves}}
    return altered(profile, name=f"{profile.name}, mix", plant={"effects": hidden})


def measured_plan(profile: Profile, plan: Mapping[str, Array], seed: int) -> dict[str, Readings]:
    """Simulate readings of all arms at ``plan`` (name -> (n, N) [rad]); ``seed`` draws noise, the profile's seed
    splits.

    Joints approach each stop from the one before, the first stop from home.
    """
    readings = measured_by(build_plant(profile), home_positions(profile), plan, seed)
    splits, _ = profile_splits(profile, readings)
    return {name: replace(arm, split=splits[name]) for name, arm in readings.items()}


def measured_by(
    plant: Plant, homes: Mapping[str, Array], plan: Mapping[str, Array], seed: int, *, noise: bool = True
) -> dict[str, Readings]:
    """Simulate readings of all arms of a plant at ``plan``, without splits; see ``measured_plan``.

    Without ``noise`` points and orientations of probes are exact.
    """
    readings, configs = {}, {config.name: config for config in plant.config.arms}
    for place, (name, q) in enumerate(plan.items()):
        approach = np.sign(np.diff(np.vstack([homes[name], q]), axis=0)).astype(np.int8)
        others = {other: rows for other, rows in plan.items() if other != name}
        exact = plant.smr_positions(name, q, approach=approach.astype(np.float64), others=others)
        points, covariance = plant.measure_positions(exact, np.random.default_rng([seed, place]))
        rotations: dict[str, Any] = {}
        if configs[name].probe is not None:
            R_M_S = plant.probe_rotations(name, q, approach=approach.astype(np.float64), others=others)
            sigma_rad = np.full(len(q), configs[name].probe_sigma)
            off = noise * sigma_rad[:, None] * np.random.default_rng([seed, place, 6]).standard_normal((len(q), 3))
            R_M_S = Rotation.from_rotvec(off).as_matrix() @ R_M_S
            rotations = {"quaternion_M": quaternions_of(R_M_S), "sigma_rad": sigma_rad}
        p_M = points if noise else exact
        readings[name] = readings_at(q, p_M, approach=approach, covariance_M=covariance, **rotations)
    return readings


def bare(profile: Profile, stops: int, plant_seed: int | None = None) -> Profile:
    """The profile with ``stops`` stops and no hidden effects; ``plant_seed`` draws another true geometry."""
    seed = sure(profile.plant).seed if plant_seed is None else plant_seed
    return altered(profile, plant={"effects": {}, "seed": seed}, plan={"stops": stops})


@cache
def bare_stops(path: Path, stops: int) -> dict[str, Array]:
    """Arm -> joint positions (n, N) of stops that all seeds share [rad]; planned once a process."""
    return dict(plan_stops(bare(load_profile(path), stops)))
