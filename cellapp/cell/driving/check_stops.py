"""Stops at which a check can measure all arms together: stops of the calibration that are clear and visible."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from cellapp.cell.driving.smr_search import APART_M
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.cell.safety.gate import clear_stops, visible_stops
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import CellModel


def check_candidates(profile: Profile, model: CellModel, readings: Mapping[str, Readings]) -> dict[str, Array]:
    """Return joint positions of all arms, arm -> (n, N) [rad]; row k of all arms is one stop.

    They are those of the readings, where the model is known, at which the arms are clear of each other and of
    everything else, the tracker of ``model`` sees all SMRs, and no SMR can be mistaken for another. Readings that were
    not taken at common stops are paired at random.

    Raises
    ------
    InputError
        If no stop is left.
    """
    stops = _together({name: readings[name] for name in model.arms}, profile.seed)
    bodies = cell_bodies(profile, model)
    usable = clear_stops(bodies, stops) & visible_stops(bodies, stops)
    p_M = {name: model.predict(name, q) for name, q in stops.items()}
    for one, other in combinations(p_M, 2):
        usable &= np.linalg.norm(p_M[one] - p_M[other], axis=1) >= APART_M
    if not usable.any():
        raise InputError(
            f"profile {profile.name}: at no stop of the calibration's readings are all arms clear and in the tracker's"
            " sight; nothing was moved"
        )
    return {name: q[usable] for name, q in stops.items()}


def _together(readings: Mapping[str, Readings], seed: int) -> dict[str, Array]:
    """Return joint positions of all arms at the stops where all were measured; if there are none, in random pairs."""
    numbers = [arm.configuration for arm in readings.values()]
    common = numbers[0]
    for one in numbers[1:]:
        common = np.intersect1d(common, one)
    if len(common):
        rows = {name: np.isin(arm.configuration, common) for name, arm in readings.items()}
        return {name: arm.q[rows[name]] for name, arm in readings.items()}
    count = min(len(arm) for arm in readings.values())
    rng = np.random.default_rng([seed, 0xC4EC])
    return {name: arm.q[rng.permutation(len(arm))[:count]] for name, arm in readings.items()}
