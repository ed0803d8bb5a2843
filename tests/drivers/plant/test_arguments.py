"""Optional arguments of ``Plant.smr_positions`` and their effect."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.plant import GeometryErrors
from drivers.plant.plant import JOINT_RISE_K, JOINT_TIME_CONSTANT_S, joint_rise
from drivers.plant.transforms import rigid, transform_points

Q = np.random.default_rng(4).uniform(-2.5, 2.5, (6, 6))
DRIFT = {"shift": [1e-3, 0.0, 0.0], "turn": [0.0, 0.0, 1e-3], "law": "linear", "time": 1000.0}
SOFT = {"joint_compliance": {"stiffness": [4e4] * 6}}


def test_explicit_defaults_change_nothing(make_arm, make_plant):
    effects = SOFT | {"backlash": {"play": [1e-4] * 6}, "base_drift": DRIFT}
    plant = make_plant(make_arm(payload_mass=3.0, payload_center=[0.1, 0.0, 0.05], effects=effects))
    plant.advance(100.0)
    aloud = plant.smr_positions(
        "left",
        Q,
        approach=np.zeros((6, 6)),
        time_s=np.full(6, 100.0),
        last_step=np.zeros((6, 6)),
        since_rest_s=np.full(6, np.inf),
        payload=np.full(6, 3.0),
        payload_center=np.array([0.1, 0.0, 0.05]),
        joints_c=np.tile(plant.joint_temperatures_c("left"), (6, 1)),
        air_c=np.full(6, plant.air_temperature_c),
    )
    assert np.array_equal(aloud, plant.smr_positions("left", Q))


def test_each_stop_may_have_its_own_load(make_arm, make_plant):
    masses = np.array([0.0, 0.5, 1.0, 5.0, 8.0, 10.0])
    centers = np.random.default_rng(0).uniform(-0.1, 0.1, (6, 3))
    found = make_plant(make_arm(effects=SOFT)).smr_positions("left", Q, payload=masses, payload_center=centers)
    for k in range(6):
        alone = make_plant(make_arm(effects=SOFT, payload_mass=masses[k], payload_center=centers[k]))
        assert np.abs(alone.smr_positions("left", Q[[k]])[0] - found[k]).max() < 1e-11
    lighter = make_plant(make_arm(effects=SOFT)).smr_positions("left", Q)
    assert np.abs(found - lighter)[5].max() > 1e-4
    # the load hung on the flange by the driver's call is the same thing
    hung = make_plant(make_arm(effects=SOFT))
    hung.set_payload("left", 5.0, centers[3])
    assert np.abs(hung.smr_positions("left", Q[[3]])[0] - found[3]).max() < 1e-11


def test_the_last_step_determines_the_approach(make_arm, make_plant):
    plant = make_plant(make_arm(effects={"backlash": {"play": [1e-4] * 6}}))
    step = np.random.default_rng(1).choice([-0.5, 0.5], (6, 6))
    told = plant.smr_positions("left", Q, last_step=step)
    assert np.array_equal(told, plant.smr_positions("left", Q, approach=np.sign(step)))
    assert np.array_equal(
        plant.smr_positions("left", Q, last_step=step, approach=np.zeros((6, 6))), plant.smr_positions("left", Q)
    )


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"last_step": np.zeros((6, 5))}, r"last_step has shape \(6, 5\), expected \(6, 6\)"),
        ({"approach": np.zeros((5, 6))}, r"approach has shape \(5, 6\), expected \(6, 6\)"),
        ({"since_rest_s": np.zeros(5)}, r"since_rest_s has shape \(5,\), expected \(6,\)"),
        ({"payload": np.zeros(5)}, r"payload has shape \(5,\), expected \(6,\)"),
        ({"payload_center": np.zeros(4)}, r"payload_center has shape \(4,\), expected \(6, 3\)"),
        ({"joints_c": np.zeros((6, 7))}, r"joints_c has shape \(6, 7\), expected \(6, 6\)"),
        ({"air_c": np.zeros(2)}, r"air_c has shape \(2,\), expected \(6,\)"),
        ({"time_s": np.zeros(2)}, r"time_s has shape \(2,\), expected \(6,\)"),
        ({"payload": np.array([1, 1, 1, 1, 1, -2.0])}, "payload must be at least 0 kg, not -2"),
    ],
)
def test_a_wrong_shape_is_one_clear_error(make_plant, wrong, message):
    with pytest.raises(ValueError, match=message):
        make_plant().smr_positions("left", Q, **wrong)


def test_true_masses_differ_by_a_share_and_move_nothing_else(make_arm, make_plant):
    length, angle = 3e-4, 1e-3
    plain = make_plant(make_arm(), errors=GeometryErrors(length, angle, 5e-3, 5e-3, 1e-3))
    heavy = make_plant(make_arm(), errors=GeometryErrors(length, angle, 5e-3, 5e-3, 1e-3, mass=0.1))
    assert np.array_equal(plain.smr_positions("left", Q), heavy.smr_positions("left", Q))
    assert np.array_equal(plain.true_T_C_B("left"), heavy.true_T_C_B("left"))
    # under springs the masses show, by about as much as they differ
    nominal, off = (
        make_plant(make_arm(effects=SOFT), errors=GeometryErrors(mass=mass)).smr_positions("left", Q)
        for mass in (0.0, 0.1)
    )
    sag = np.linalg.norm(nominal - make_plant().smr_positions("left", Q), axis=1).max()
    assert 0.005 * sag < np.linalg.norm(off - nominal, axis=1).max() < 0.4 * sag


def test_mass_errors_have_the_configured_size(make_arm, make_plant):
    nominal = make_arm().masses
    shares = np.array(
        [
            make_plant(seed=seed, errors=GeometryErrors(mass=0.08))._arm("left").mechanism.masses / nominal - 1.0
            for seed in range(60)
        ]
    )
    assert np.std(shares) == pytest.approx(0.08, rel=0.15)
    assert np.abs(shares.mean()) < 0.02
    double = make_plant(seed=0, errors=GeometryErrors(mass=0.16))._arm("left").mechanism.masses / nominal - 1.0
    assert double == pytest.approx(2.0 * shares[0])
    huge = make_plant(seed=0, errors=GeometryErrors(mass=50.0))._arm("left").mechanism.masses
    assert (huge > 0.0).all()


def test_a_joint_warms_up_while_it_turns_and_cools_down_at_rest():
    keep = np.exp(-600.0 / JOINT_TIME_CONSTANT_S)
    warm = joint_rise(np.zeros(1), np.array([0.1]), 600.0)
    assert warm == pytest.approx(0.1 * JOINT_RISE_K * (1.0 - keep))
    assert joint_rise(warm, np.zeros(1), 600.0) == pytest.approx(warm * keep)


def test_joints_that_are_switched_on_become_warm_without_moving(make_plant):
    held = make_plant(holding_k=8.0)
    held.advance(JOINT_TIME_CONSTANT_S)
    assert held.joint_temperatures_c("left") - held.air_temperature_c == pytest.approx(8.0 * (1.0 - np.exp(-1.0)))


def test_a_moved_tracker_sees_the_same_cell_from_elsewhere(make_plant):
    plant, moved = make_plant(), make_plant()
    T_C_M = rigid(np.array([3.0, 0.7, 0.2, 0.1, -0.2, 2.5]))
    moved.move_tracker(T_C_M)
    in_cell = transform_points(plant.config.tracker.T_C_M, plant.smr_positions("left", Q))
    np.testing.assert_allclose(transform_points(T_C_M, moved.smr_positions("left", Q)), in_cell, atol=1e-12)
    (found,) = (target for target in moved.targets() if target.arm == "left")
    np.testing.assert_allclose(found.p_M, moved.smr_positions("left", moved.q("left")[None])[0], atol=1e-9)
