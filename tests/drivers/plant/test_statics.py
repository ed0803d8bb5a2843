"""Gravity torques and elastic joints."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import root

from drivers.plant import gravity_torques
from drivers.plant.mechanism import STANDARD_GRAVITY


def _largest(arm, joint):
    """The largest torque on a joint over all postures: coordinate search, exact enough as the torque is sinusoidal."""
    turn = np.linspace(-np.pi, np.pi, 361)
    best = 0.0
    for start in np.random.default_rng(0).uniform(-np.pi, np.pi, (4, 6)):
        q = start.copy()
        for _ in range(6):
            for k in range(1, 6):
                trial = np.tile(q, (len(turn), 1))
                trial[:, k] = turn
                torque = np.abs(gravity_torques(arm, trial)[:, joint])
                q[k] = turn[np.argmax(torque)]
        best = max(best, float(torque.max()))
    return best


@pytest.mark.parametrize(
    ("kind", "payload", "published", "within"),
    [
        ("ur10", 0.0, (122, 41, 3), 0.5),
        ("ur5", 0.0, (55, 17, 1.5), 0.5),
        # the published loads hang in front of the flange; one distance for both arms fits all six figures
        ("ur10", 10.0, (257, 117, 23), 1.0),
        ("ur5", 5.0, (104, 45, 10), 1.0),
    ],
)
def test_the_largest_gravity_torques_are_the_published_ones(make_arm, kind, payload, published, within):
    arm = make_arm(kind, payload_mass=payload, payload_center=np.array([0.0, 0.0, 0.08]))
    found = [_largest(arm, joint) for joint in (1, 2, 3)]
    assert found == pytest.approx(published, abs=within)


@pytest.mark.parametrize("payload", [0.0, 4.0])
def test_the_torque_is_the_slope_of_the_potential_energy(make_arm, dh_frames, payload):
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]  # on a wall: every joint feels gravity
    arm = make_arm(T_C_B=pose, payload_mass=payload, payload_center=np.array([0.02, -0.03, 0.1]))

    def energy(q):
        frames = dh_frames(arm.rows, q)
        places = [frame @ np.append(c, 1.0) for frame, c in zip(frames[1:], arm.centers_of_mass)]
        weights = np.append(arm.masses, payload)
        places.append(frames[-1] @ np.append(arm.payload_center, 1.0))
        return STANDARD_GRAVITY * sum(m * (pose @ p)[2] for m, p in zip(weights, places))

    step = 1e-5
    for q in np.random.default_rng(2).uniform(-np.pi, np.pi, (5, 6)):
        slope = [(energy(q + step * unit) - energy(q - step * unit)) / (2 * step) for unit in np.eye(6)]
        torque = gravity_torques(arm, q)[0]
        assert torque == pytest.approx(-np.array(slope), abs=1e-6)
        assert np.abs(torque).max() > 1.0


def test_springs_balance_gravity_at_the_deflected_posture(make_arm, make_config, make_plant, dh_smr):
    stiffness = np.array([2e4, 1.5e4, 1e4, 3e3, 3e3, 1e3])  # soft, so that the undeflected posture is not good enough
    arm = make_arm(
        payload_mass=8.0,
        payload_center=np.array([0.05, 0.0, 0.1]),
        effects={"joint_compliance": {"stiffness": stiffness.tolist()}},
    )
    q = np.random.default_rng(4).uniform(-np.pi, np.pi, (20, 6))
    balanced = []
    for row in q:
        solved = root(lambda x: stiffness * (x - row) - gravity_torques(arm, x)[0], row, tol=1e-14)  # noqa: B023
        balanced.append(solved.x)
    config, plant = make_config(arm), make_plant(arm)
    found = plant.smr_positions("left", q)
    assert np.abs(found - dh_smr(config, np.array(balanced))).max() < 2e-12
    first_order = q + gravity_torques(arm, q) / stiffness
    assert np.abs(found - dh_smr(config, first_order)).max() > 1e-5
    assert np.abs(found - dh_smr(config, q)).max() > 1e-3


def test_gravity_pulls_the_hand_down(make_arm, make_plant):
    arm = make_arm(effects={"joint_compliance": {"stiffness": [5e4] * 6}})
    stretched = np.zeros((1, 6))
    sag = make_plant(arm).smr_positions("left", stretched) - make_plant(make_arm()).smr_positions("left", stretched)
    assert -5e-3 < sag[0, 2] < -1e-3


def test_an_infinite_stiffness_is_stiff(make_arm, make_plant):
    arm = make_arm(effects={"joint_compliance": {"stiffness": [float("inf")] * 6}})
    q = np.random.default_rng(0).uniform(-3, 3, (5, 6))
    assert np.array_equal(make_plant(arm).smr_positions("left", q), make_plant().smr_positions("left", q))


def test_a_load_hung_on_later_acts_like_one_configured(make_arm, make_plant):
    effects = {"joint_compliance": {"stiffness": [5e4] * 6}}
    center = np.array([0.0, 0.02, 0.08])
    q = np.random.default_rng(0).uniform(-3, 3, (5, 6))
    plant = make_plant(make_arm(effects=effects))
    bare = plant.smr_positions("left", q)
    plant.set_payload("left", 6.0, center)
    configured = make_plant(make_arm(effects=effects, payload_mass=6.0, payload_center=center))
    assert np.array_equal(plant.smr_positions("left", q), configured.smr_positions("left", q))
    assert np.abs(plant.smr_positions("left", q) - bare).max() > 1e-4
    assert plant.payload("left")[0] == 6.0


def test_springs_too_soft_to_hold_the_arm_are_refused(make_arm, make_plant):
    arm = make_arm(effects={"joint_compliance": {"stiffness": [5.0] * 6}})
    with pytest.raises(ValueError, match="arm left: the hidden effects reach no equilibrium"):
        make_plant(arm).smr_positions("left", np.full((1, 6), 0.3))
