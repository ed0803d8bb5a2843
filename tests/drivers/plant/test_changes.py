"""Changes of a true mechanism between two days are those of D-H parameters."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from cellapp.robot.kinematics.chain import parameter_names, smr_positions
from drivers.plant.changes import lengthened, link_moved, zero_shifted
from tests.arms import OFF_AXIS, UR10, at_station, plant_of

Q = np.random.default_rng(4).uniform(-2.0, 2.0, (9, 6))
SIZE = 1e-3


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("name", ["theta", "d", "a", "alpha", "beta"])
def test_a_change_of_the_mechanism_is_that_of_a_parameter(name, joint):
    twist = SIZE * np.eye(6)[{"a": 0, "alpha": 3, "beta": 4}.get(name, 0)]
    change = {
        "theta": partial(zero_shifted, joint=joint, angle=SIZE),
        "d": partial(lengthened, joint=joint, length=SIZE),
    }.get(name, partial(link_moved, joint=joint, twist=twist))
    plant = plant_of(UR10, OFF_AXIS)
    before = plant.smr_positions("arm", Q)
    plant.change_mechanism("arm", change)
    geometry = at_station(UR10, OFF_AXIS)
    vector = geometry.vector()
    vector[parameter_names(6).index(f"{name}{joint + 1}")] += SIZE
    np.testing.assert_allclose(plant.smr_positions("arm", Q), smr_positions(geometry.with_vector(vector), Q), atol=1e-9)
    assert np.abs(plant.smr_positions("arm", Q) - before).max() > 1e-5


def test_bodies_move_with_their_link():
    mechanism = plant_of(UR10, OFF_AXIS).true_mechanism("arm")
    changed = lengthened(mechanism, 2, SIZE)
    np.testing.assert_allclose(changed.centers[:2], mechanism.centers[:2])
    shift = np.tile(SIZE * mechanism.directions[2], (4, 1))
    np.testing.assert_allclose(changed.centers[2:] - mechanism.centers[2:], shift, atol=1e-15)
    np.testing.assert_allclose(changed.frames[3:, :3, 3] - mechanism.frames[3:, :3, 3], shift, atol=1e-15)
