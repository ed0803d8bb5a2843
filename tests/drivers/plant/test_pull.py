"""A static force on the flange: the hidden springs, beams and columns yield to it as to a weight."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.plant.mechanism import STANDARD_GRAVITY

pytestmark = pytest.mark.fast

Q = np.random.default_rng(7).uniform(-2.5, 2.5, (4, 6))
STEP_N = 0.5
ELASTIC = {
    "joints": {"joint_compliance": {"stiffness": [3e4, 4e4, 2e4, 8e3, 8e3, 8e3]}},
    "drives under load": {"payload_compliance": {"stiffness": [3e4, 4e4, 2e4, 8e3, 8e3, 8e3]}},
    "links": {"link_bending": {"links": [2, 3], "bending": [2e4, 1e4], "torsion": [1e4, 8e3]}},
    "pedestal": {"pedestal_compliance": {"height": 0.8, "bending": [2e6, 1e6], "torsion": 5e5}},
}


def _compliance(plant):
    """Displacement of the flange's origin for each newton, (n, 3, 3) [m/N], in the base."""
    rotation = plant.true_T_M_B("left")[:3, :3]
    columns = []
    for axis in np.eye(3):
        ends = []
        for sign in (1.0, -1.0):
            plant.set_pull("left", sign * STEP_N * axis)
            ends.append(plant.smr_positions("left", Q) @ rotation)
        columns.append((ends[0] - ends[1]) / (2.0 * STEP_N))
    plant.set_pull("left", None)
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("name", ELASTIC)
def test_an_elastic_arm_answers_each_force_as_the_reciprocal_theorem_says(make_arm, make_plant, name):
    """Maxwell and Betti: the displacement at a along u by a force along v is that along v by one along u."""
    plant = make_plant(make_arm(effects=ELASTIC[name], smr_offset=np.zeros(3)))
    compliance = _compliance(plant)
    largest = np.abs(compliance).max()
    assert largest > 1e-8
    assert np.abs(compliance - compliance.swapaxes(1, 2)).max() < 2e-3 * largest
    assert (np.linalg.eigvalsh(0.5 * (compliance + compliance.swapaxes(1, 2))) > -2e-3 * largest).all()


def test_a_downward_force_is_a_weight_at_the_flange(make_arm, make_plant):
    effects = ELASTIC["joints"]
    plant = make_plant(make_arm(effects=effects))
    hung = plant.smr_positions("left", Q, payload=np.full(4, 3.0), payload_center=np.zeros(3))
    plant.set_payload("left", 0.0, np.zeros(3))
    down_B = make_arm().T_C_B[:3, :3].T @ np.array([0.0, 0.0, -3.0 * STANDARD_GRAVITY])
    plant.set_pull("left", down_B)
    np.testing.assert_allclose(plant.smr_positions("left", Q), hung, atol=1e-12)
    plant.set_pull("left", None)
    assert np.abs(plant.smr_positions("left", Q) - hung).max() > 1e-5


def test_a_rigid_arm_does_not_yield(make_plant):
    plant = make_plant()
    before = plant.smr_positions("left", Q)
    plant.set_pull("left", np.array([100.0, 0.0, 0.0]))
    np.testing.assert_array_equal(plant.smr_positions("left", Q), before)
