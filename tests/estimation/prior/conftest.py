"""A simulated UR10 that was calibrated, and readings of it after it was mounted elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.quantities import ArmReadings
from cellapp.estimation.prior.belief import Belief
from cellapp.estimation.prior.calibrate import Earlier, believed
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.transforms import rotation_from_vector, transform
from cellapp.robot.model import ArmModel
from tests.arms import effect_term, measured_rotations, true_geometry
from tests.series import readings_at
from tests.twin import PROFILES

SIGMA_M, SIGMA_RAD = 1e-5, 2e-5
STIFF = np.array([1.0e-5, 1.5e-5, 3.0e-5, 8.0e-5, 8.0e-5])
"""Compliance of joints 2 to 6 [rad/Nm]."""


@dataclass(frozen=True, eq=False)
class SimulatedArm:
    """The true arm: its model predicts what would be measured without noise."""

    profile: Profile
    model: ArmModel

    def readings(self, count: int, seed: int, learn: int | None = None) -> Readings:
        """Readings at random configurations; those after ``learn`` are held out; a probe's have orientation."""
        rng = np.random.default_rng([seed, 7])
        q = rng.uniform(-2.0, 2.0, (count, 6))
        p_M = self.model.predict(q) + rng.normal(0.0, SIGMA_M, (count, 3))
        learn = count - 1 if learn is None else learn
        angular: dict[str, Any] = {}
        if self.model.geometry.probe is not None:
            angular = {"quaternion_M": measured_rotations(self.model, q, SIGMA_RAD, rng), "sigma_rad": SIGMA_RAD}
        split = ("identify",) * learn + ("validate",) * (count - learn)
        return readings_at(q, p_M, sigma_m=SIGMA_M, split=split, **angular)

    def mounted(self, T_M_B: np.ndarray, tool: np.ndarray) -> SimulatedArm:
        """The same arm on another base with another tool."""
        geometry = replace(self.model.geometry, tool=tool).with_T_M_B(T_M_B)
        return replace(self, model=replace(self.model, geometry=geometry))

    def with_probe(self, probe: np.ndarray) -> SimulatedArm:
        """The same arm with a probe in place of its SMR."""
        geometries = (replace(one, probe=probe) for one in (self.model.geometry, self.model.nominal))
        return replace(self, model=replace(self.model, geometry=next(geometries), nominal=next(geometries)))

    def with_rows(self, change: np.ndarray) -> SimulatedArm:
        """The same arm with D-H rows changed."""
        geometry = replace(self.model.geometry, rows=self.model.geometry.rows + change)
        return replace(self, model=replace(self.model, geometry=geometry))


ELSEWHERE = transform(rotation_from_vector([0.3, 0.2, -1.1]), [1.9, -1.4, 0.3])


@pytest.fixture(scope="session")
def arm() -> SimulatedArm:
    profile = load_profile(PROFILES / "twin.yaml")
    profile = profile.model_copy(update={"arms": {"left": profile.arms["left"]}})
    q, p_M = np.random.default_rng(0).uniform(-2, 2, (30, 6)), np.random.default_rng(1).uniform(-1, 1, (30, 3))
    empty = readings_at(q, p_M, split=30)
    model = calibrate_arm(profile, "left", empty)[0].model
    start = transform(rotation_from_vector([0.0, 0.0, 2.0]), [2.6, 0.9, -0.7])
    geometry = true_geometry(model.nominal.with_T_M_B(start), np.random.default_rng(5))
    values = {f"compliance{joint}": value for joint, value in enumerate(STIFF.tolist(), start=2)}
    law = EFFECTS["joint_compliance"].forms[0].law()
    term = effect_term("joint_compliance", values, "rad/Nm", law=law)
    return SimulatedArm(profile, replace(model, geometry=geometry, effects=(term,), network=None, posterior=None))


@pytest.fixture(scope="session")
def earlier(arm: SimulatedArm) -> Earlier:
    """What 200 readings say of the arm."""
    readings = arm.readings(200, seed=1)
    belief, count = believed(ArmReadings.alone(arm.profile, "left", arm.model, readings))
    return earlier_of(belief, count)


def earlier_of(belief: Belief, count: int) -> Earlier:
    """An earlier calibration with some belief."""
    return Earlier(belief, Path("earlier"), "discover", "00", "2026-03-01", count, None, (), ())
