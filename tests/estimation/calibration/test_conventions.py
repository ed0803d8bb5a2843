"""Whether an arm explains recorded readings, and which signs or units do: on simulated arms and on real readings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.starters import arm_type_files
from cellapp.estimation.calibration.registration import better_reading, explained
from cellapp.robot.kinematics.chain import nominal_geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array, rotation_from_vector, transform
from cellapp.robot.model.nominal import nominal_arm
from tests.arms import UR10

pytestmark = pytest.mark.fast

ROOT = Path(__file__).parents[3]
NOMINAL = nominal_geometry(UR10, np.zeros(3))


def readings(seed: int, n: int = 150) -> tuple[Array, Array]:
    """Joint positions and points of a UR10 whose rows are off by millimetres, with an unknown base and tool."""
    rng = np.random.default_rng(seed)
    rows = UR10 + rng.normal(0.0, [2e-3, 1e-3, 1e-3, 2e-3], (6, 4))
    T_M_B = transform(rotation_from_vector(rng.normal(size=3)), rng.uniform(-3.0, 3.0, 3))
    geometry = nominal_geometry(rows, rng.uniform(-0.2, 0.2, 3), T_M_B)
    q = rng.uniform(-2.5, 2.5, (n, 6))
    return q, smr_positions(geometry, q)


@pytest.mark.parametrize("seed", range(4))
def test_the_right_arm_explains_and_a_wrong_unit_does_not(seed: int) -> None:
    q, p_M = readings(seed)
    found = explained(NOMINAL, q, p_M)
    assert found.holds
    assert found.rms_m < 0.02
    assert not explained(NOMINAL, np.degrees(q), p_M).holds
    assert not explained(NOMINAL, q, 1e3 * p_M).holds


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda q: q * [1, -1, 1, 1, 1, 1], "q2 with the opposite sign"),
        (lambda q: q * [1, -1, -1, 1, -1, 1], "q2, q3, q5 with the opposite sign"),
        (lambda q: q - np.outer(q[:, 1], [0, 0, 1, 0, 0, 0]), "q3 + q2 in place of q3"),
    ],
)
def test_the_convention_of_the_controller_is_named(wrong: Callable[[Array], Array], words: str) -> None:
    q, p_M = readings(7)
    assert not explained(NOMINAL, wrong(q), p_M).holds
    found = better_reading(NOMINAL, wrong(q), p_M)
    assert found is not None
    assert found[0] == words
    assert found[1].holds


def test_points_at_random_fit_no_convention() -> None:
    q, p_M = readings(9)
    assert better_reading(NOMINAL, q, p_M[::-1]) is None


@pytest.mark.parametrize(("series", "arm"), [("ur10-real", "ur10"), ("ur10-real-d", "ur10"), ("ur5-real", "ur5")])
def test_real_readings_fit_their_arm_alone(series: str, arm: str) -> None:
    table = np.genfromtxt(
        ROOT / "tests" / "fixtures" / series / "readings.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    q = np.column_stack([table[f"q{number}"] for number in range(1, 7)])
    p_M = np.column_stack([table[name] for name in ("x_m", "y_m", "z_m")])
    profile = load_profile(ROOT / "profiles" / "ur10-ur5.yaml")
    arms = {"ur10": profile.arms["left"], "ur5": profile.arms["right"]}
    fits = {name: explained(nominal_arm(one), q, p_M).holds for name, one in arms.items()}
    assert fits == {name: name == arm for name in arms}
    assert len(arm_type_files()) > len(arms)
