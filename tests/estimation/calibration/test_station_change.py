"""Detection of a moved station: found where it moved, no false alarm where it did not."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.calibration.calibrate import station_change
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.kinematics.transforms import apply, rotation_from_vector, transform
from tests.arms import OFF_AXIS, UR10, at_station, true_geometry

pytestmark = pytest.mark.fast


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("at", [60, 200, 333])
def test_a_moved_station_is_found_where_it_moved(seed, at):
    rng = np.random.default_rng(seed)
    nominal = at_station(UR10, OFF_AXIS, np.eye(4))
    q = rng.uniform(-3, 3, (400, 6))
    p_M = smr_positions(true_geometry(nominal, rng), q)
    assert station_change(smr_positions(nominal, q), p_M) is None
    moved = transform(rotation_from_vector(rng.normal(0.0, 0.05, 3)), rng.normal(0.0, 0.1, 3))
    p_M[at:] = apply(moved, p_M[at:])
    assert station_change(smr_positions(nominal, q), p_M) == pytest.approx(at, abs=2)


def test_few_points_are_not_judged():
    p = np.random.default_rng(0).normal(size=(8, 3))
    assert station_change(p, p) is None
