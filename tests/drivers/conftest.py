"""Fixtures: two published arms, cells made of them, and a D-H chain for comparison."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers.plant import ArmConfig, Plant, PlantConfig
from tests.arms import arm_config, dh_frames, plant_config


@pytest.fixture(scope="session")
def make_arm() -> Callable[..., ArmConfig]:
    return arm_config


@pytest.fixture(scope="session")
def seven_joints() -> ArmConfig:
    """An arm of seven joints whose masses are not known."""
    arm = arm_config()
    return replace(
        arm,
        rows=np.vstack([arm.rows, [0.0, 0.1, 0.0, 0.0]]),
        limits=np.vstack([arm.limits, [-1.0, 1.0]]),
        home=None,
        speed=np.ones(7),
        acceleration=np.ones(7),
        masses=np.zeros(7),
        centers_of_mass=np.zeros((7, 3)),
    )


@pytest.fixture(scope="session")
def make_config() -> Callable[..., PlantConfig]:
    return plant_config


@pytest.fixture(scope="session")
def make_plant() -> Callable[..., Plant]:
    """``make_plant(*arms, ...)``: the plant of ``plant_config``."""
    return lambda *arms, **changes: Plant(plant_config(*arms, **changes))


@pytest.fixture(scope="session")
def dh_smr() -> Callable[[PlantConfig, np.ndarray], np.ndarray]:
    """``dh_smr(config, q)``: SMR (n, 3) in M of the first arm of a perfect cell at ``q`` (n, N)."""

    def positions(config: PlantConfig, q: np.ndarray) -> np.ndarray:
        arm = config.arms[0]
        pose = np.linalg.inv(config.tracker.T_C_M) @ arm.T_C_B
        return np.asarray((pose @ dh_frames(arm.rows, q)[-1] @ np.append(arm.smr_offset, 1.0))[:, :3])

    return positions
