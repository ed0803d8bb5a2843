"""Simulated readings for trials: as if the plan were collected, without simulated motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.estimation.calibration.calibrate import profile_splits
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array
from drivers.plant import Plant


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

    Without ``noise`` the points are exact.
    """
    readings = {}
    for place, (name, q) in enumerate(plan.items()):
        approach = np.sign(np.diff(np.vstack([homes[name], q]), axis=0)).astype(np.int8)
        others = {other: rows for other, rows in plan.items() if other != name}
        exact = plant.smr_positions(name, q, approach=approach.astype(np.float64), others=others)
        points, covariance = plant.measure_positions(exact, np.random.default_rng([seed, place]))
        readings[name] = Readings(
            configuration=np.arange(len(q)),
            time_s=np.full(len(q), np.nan),
            q=q,
            approach=approach,
            p_M=points if noise else exact,
            covariance_M=covariance,
        )
    return readings
