"""Readings with the approach signs of another convention: said, counted as unknown, with what to check."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellapp.cell.profile import load_profile
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.discovery.records import ArmDiscoveryResult
from cellapp.estimation.readings import Readings
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm
from tests.arms import STATION

TWIN = Path(__file__).parents[3] / "profiles" / "twin.yaml"
STOPS, HELD_OUT = 240, 60
SIGMA_M = 10e-6
HALF_PLAY = np.array([1.5e-4, 1e-4, 0.0, 0.0, 0.0, 0.0])


def discovered(sign: int) -> ArmDiscoveryResult:
    """Discovery in readings with backlash whose approach signs are multiplied by ``sign``."""
    profile = load_profile(TWIN)
    few = profile.discovery.model_copy(update={"null_simulations": 60, "false_alarm": 0.02})
    profile = profile.model_copy(update={"discovery": few})
    arm = profile.arms["left"]
    geometry = nominal_arm(arm).with_T_M_B(STATION)
    up_M = STATION[:3, :3] @ np.array([0.0, 0.0, 1.0])
    model = ArmModel(geometry=geometry, nominal=geometry, bodies=bodies_of(arm), up_M=up_M)
    rng = np.random.default_rng(5)
    q, approach = rng.uniform(-2.5, 2.5, (STOPS, 6)), rng.choice([-1, 1], (STOPS, 6))
    readings = Readings(
        configuration=np.arange(STOPS, dtype=np.int64),
        time_s=np.full(STOPS, np.nan),
        q=q,
        approach=(sign * approach).astype(np.int8),
        p_M=smr_positions(geometry, q - HALF_PLAY * approach) + rng.normal(0.0, SIGMA_M, (STOPS, 3)),
        sigma_m=np.full(STOPS, SIGMA_M),
        split=("identify",) * (STOPS - HELD_OUT) + ("validate",) * HELD_OUT,
    )
    return discover_arm(profile, "left", model, readings).result


def test_backlash_of_the_opposite_sign_is_said_and_unknown() -> None:
    arm = discovered(sign=-1)
    assert arm.verdict == "unknown effect"
    (found,) = arm.contradictions
    assert (found.effect, found.joints) == ("backlash", (1, 2))
    assert "of the opposite sign at joints 1, 2: check the approach convention" in found.sentence
    assert 100.0 < found.size_um < 200.0
    (accepted,) = arm.accepted
    assert accepted.effect == "unknown"
    assert accepted.meaning is not None
    assert accepted.meaning.check[0] == "Check the approach convention of the readings."


def test_backlash_of_the_right_sign_is_named() -> None:
    arm = discovered(sign=1)
    assert [found.effect for found in arm.accepted] == ["backlash"]
    assert arm.verdict != "unknown effect"
    assert arm.contradictions == ()
