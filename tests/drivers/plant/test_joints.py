"""Hidden effects of drives, encoders and bearings that do not depend on loads."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.plant.effect import Parameters
from drivers.plant.effects import FACTORIES
from drivers.plant.effects.joint_axis_wobble import tilt_of_two_lobes

FAST = {"speed": np.full(6, 2.0), "acceleration": np.full(6, 3.0)}
Q = np.random.default_rng(3).uniform(-2.5, 2.5, (8, 6))


def _positions(make_arm, make_plant, effects, q=Q, **situation):
    return make_plant(make_arm(effects=effects)).smr_positions("left", q, **situation)


def _offset(name, values, q, **situation):
    """Deflection by one effect at ``q`` (n, N)."""
    effect = FACTORIES[name](Parameters("left", name, values, q.shape[1]))
    inputs: Any = SimpleNamespace(q=q, **situation)
    return effect.offset(inputs, None)


def _sweep(joint, count=4096):
    q = np.zeros((count, 6))
    q[:, joint] = np.arange(count) / count * 2 * np.pi
    return q


def _go(plant, q):
    plant.start_move("left", np.asarray(q, dtype=float), **FAST)
    plant.advance(max(plant.rest_s("left") - plant.clock_s, 0.0))


# -- lost motion that saturates ----------------------------------------------------------------------------------------

TEETH = {"play": [2e-4] * 6, "reach": [0.2] * 6}


def test_lost_motion_grows_with_the_step_and_saturates(make_arm, make_plant):
    effects = {"backlash": TEETH}
    q, ideal = np.zeros((1, 6)), make_plant()
    lags = []
    for step in (1e-3, 2e-3, 0.2, 0.5, 5.0):
        found = _positions(make_arm, make_plant, effects, q, last_step=np.array([[step, 0, 0, 0, 0, 0]]))
        pose = ideal.true_T_M_B("left")
        p, p0 = ((x - pose[:3, 3]) @ pose[:3, :3] for x in (found, ideal.smr_positions("left", q)))
        lags.append(float((np.arctan2(p0[:, 1], p0[:, 0]) - np.arctan2(p[:, 1], p[:, 0]))[0]))
    assert lags[1] == pytest.approx(2.0 * lags[0], rel=1e-6)  # nothing slips yet
    # the mean of min(step / slip, 1) over slips spread exponentially about the step: 1 - 1/e + E1(1)
    assert lags[2] == pytest.approx(1e-4 * (1.0 - np.exp(-1.0) + 0.21938), rel=0.01)
    assert np.all(np.diff(lags) > 0.0)
    assert lags[4] == pytest.approx(1e-4, rel=1e-6)


def test_from_afar_all_of_it_is_lost_and_without_a_side_none(make_arm, make_plant):
    side = np.random.default_rng(0).choice([-1.0, 1.0], (8, 6))
    saturated = _positions(make_arm, make_plant, {"backlash": TEETH}, approach=side)
    assert np.abs(saturated - make_plant().smr_positions("left", Q - side * 1e-4)).max() < 1e-12
    assert np.array_equal(_positions(make_arm, make_plant, {"backlash": TEETH}), make_plant().smr_positions("left", Q))


def test_given_steps_agree_with_executed_steps(make_arm, make_plant):
    effects = {
        "backlash": TEETH,
        "unsettled_measurement": {"fraction": [1e-4] * 6, "time_constant": [5.0] * 6},
        "friction_windup": {"friction": [4.0] * 6, "load_friction": [0.05] * 6, "stiffness": [5e4] * 6},
    }
    plant = make_plant(make_arm(effects=effects))
    before = plant.q("left")
    for q in np.random.default_rng(1).uniform(-0.6, 0.6, (5, 6)):
        _go(plant, q)
        plant.advance(1.5)
        told = plant.smr_positions("left", q[None], last_step=(q - before)[None], since_rest_s=np.array([1.5]))
        assert np.abs(plant.targets()[0].p_M - told[0]).max() < 1e-11
        before = q


def test_a_joint_that_does_not_move_keeps_its_lag(make_arm, make_plant):
    plant = make_plant(make_arm(effects={"backlash": TEETH}))
    _go(plant, [0.1, 0, 0, 0, 0, 0])
    _go(plant, [0.1, 0, 0, 0, 0, 1.0])
    q, step = np.array([[0.1, 0, 0, 0, 0, 1.0]]), np.array([[0.1, 0, 0, 0, 0, 1.0]])
    assert np.abs(plant.targets()[0].p_M - plant.smr_positions("left", q, last_step=step)[0]).max() < 1e-12


def test_a_step_inside_simple_play_does_not_reach_its_edge(make_arm, make_plant):
    found = _positions(make_arm, make_plant, {"backlash": {"play": [1e-3] * 6}}, last_step=np.full((8, 6), 2e-4))
    assert np.abs(found - make_plant().smr_positions("left", Q - 2e-4)).max() < 1e-12


# -- creep -------------------------------------------------------------------------------------------------------------


def test_the_rest_of_a_step_decays_at_rest(make_arm, make_plant):
    values = {"fraction": [1e-4] * 6, "time_constant": [4.0] * 6}
    step = np.random.default_rng(0).uniform(-2, 2, (8, 6))
    for rest, left in ((0.0, 1.0), (4.0, np.exp(-1.0)), (4.0 * np.log(2.0), 0.5), (np.inf, 0.0)):
        found = _positions(
            make_arm, make_plant, {"unsettled_measurement": values}, last_step=step, since_rest_s=np.full(8, rest)
        )
        assert np.abs(found - make_plant().smr_positions("left", Q - 1e-4 * left * step)).max() < 1e-12


def test_creep_needs_a_step(make_arm, make_plant):
    values = {"fraction": [1e-4] * 6, "time_constant": [4.0] * 6}
    found = _positions(make_arm, make_plant, {"unsettled_measurement": values}, since_rest_s=np.zeros(8))
    assert np.array_equal(found, make_plant().smr_positions("left", Q))


# -- drives that turn unevenly -----------------------------------------------------------------------------------------

GEAR = {
    "mode": "lines",
    "joints": [2],
    "ratio": [100.0],
    "eccentric": [0.0],
    "eccentric_phase": [0.4],
    "coupling_slant": [0.0],
    "coupling_phase": [1.1],
    "output_slant": [0.0],
    "output_phase": [2.0],
}


def _lines(values):
    """Amplitude of each cycle per revolution of joint 2 [rad], mean left out."""
    error = _offset("transmission_error", values, _sweep(1)).joints
    assert np.abs(np.delete(error, 1, axis=1)).max() == 0.0
    amplitudes = 2.0 * np.abs(np.fft.rfft(error[:, 1])) / len(error)
    amplitudes[0] = 0.0
    return amplitudes


@pytest.mark.parametrize(
    ("cause", "size", "cycles", "height"),
    [
        ("output_slant", 0.0126, 2, 0.0126**2 / 4),
        ("eccentric", 4e-3, 100, 4e-3 / 100),
        ("coupling_slant", 0.11, 200, np.tan(0.055) ** 2 / 100),
    ],
)
def test_each_cause_in_the_drive_has_its_line(cause, size, cycles, height):
    amplitudes = _lines(GEAR | {cause: [size]})
    assert amplitudes[cycles] == pytest.approx(height, rel=1e-3)
    assert 20e-6 < amplitudes[cycles] < 50e-6
    amplitudes[cycles] = 0.0
    assert amplitudes.max() < 0.01 * height


def test_an_even_drive_turns_evenly():
    assert np.abs(_offset("transmission_error", GEAR, _sweep(1)).joints).max() < 1e-14


CURVE = {"mode": "curve", "joints": [2, 3], "rms": [5e-5, 2e-5], "seed": 5, "lowest": 5, "highest": 40}


def test_the_curve_is_periodic_smooth_and_of_the_wanted_cycles():
    error = _offset("transmission_error", CURVE, _sweep(1)).joints[:, 1]
    assert np.sqrt((error**2).mean()) == pytest.approx(5e-5, rel=1e-3)
    power = np.abs(np.fft.rfft(error)) ** 2
    assert power[5:41].sum() > 0.9999 * power.sum()
    assert (power[5:41] > 1e-6 * power.max()).sum() > 25
    round_again = _offset("transmission_error", CURVE, _sweep(1) - 4 * np.pi).joints[:, 1]
    assert np.abs(round_again - error).max() < 1e-12


def test_the_curve_is_drawn_by_its_seed_and_each_joint_has_its_own():
    q = np.tile(_sweep(1)[:, [1]], (1, 6))
    error = _offset("transmission_error", CURVE, q).joints
    assert np.array_equal(error, _offset("transmission_error", CURVE, q).joints)
    other = _offset("transmission_error", CURVE | {"seed": 6}, q).joints
    assert np.abs(np.corrcoef(error[:, 1], other[:, 1])[0, 1]) < 0.5
    assert np.abs(np.corrcoef(error[:, 1], error[:, 2])[0, 1]) < 0.5
    assert np.std(error[:, 2]) == pytest.approx(2e-5, rel=1e-3)
    assert np.abs(error[:, [0, 3, 4, 5]]).max() == 0.0


def test_an_uneven_drive_moves_the_arm_as_the_joint_would(make_arm, make_plant):
    error = _offset("transmission_error", CURVE, Q).joints
    found = _positions(make_arm, make_plant, {"transmission_error": CURVE})
    assert np.abs(found - make_plant().smr_positions("left", Q + error)).max() < 1e-13


# -- bearings ----------------------------------------------------------------------------------------------------------

BEARING = {
    "joints": [1, 3],
    "radius": [0.06] * 2,
    "two_lobes": [2e-6] * 2,
    "three_lobes": [0.0] * 2,
    "phase": [0.5] * 2,
}


def test_two_lobes_tilt_the_axis_twice_a_turn_and_three_thrice():
    q = np.random.default_rng(1).uniform(-3, 3, (20, 6))
    for changes, turn in (({}, np.pi), ({"two_lobes": [0.0] * 2, "three_lobes": [2e-6] * 2}, 2 * np.pi / 3)):
        one, again, between = (_offset("joint_axis_wobble", BEARING | changes, q + by) for by in (0.0, turn, turn / 2))
        for part in ("base", "links"):
            assert np.abs(getattr(one, part)).max() > 1e-7
            assert np.abs(getattr(one, part) - getattr(again, part)).max() < 1e-18
        assert np.abs(one.links + between.links).max() < 1e-18  # half a lobe on, the other way


def test_the_tilt_follows_from_the_lobes_and_depends_on_its_own_joint_only():
    found = _offset("joint_axis_wobble", BEARING, _sweep(0))
    tilt = np.linalg.norm(found.base[:, 3:], axis=1)
    assert np.sqrt((tilt**2).mean()) == pytest.approx(tilt_of_two_lobes() * 2e-6 / 0.06)
    assert np.abs(found.base[:, [0, 1, 5]]).max() == 0.0  # the axis tilts and rises; that is all
    assert np.ptp(found.links, axis=0).max() == 0.0  # joint 3 has not turned
    assert np.abs(np.delete(found.links, 1, axis=1)).max() == 0.0  # it tilts the axis that frame 2 carries


def test_the_axis_of_joint_1_tilts_about_the_base(make_arm, make_plant):
    values = {"joints": [1], "radius": [0.06], "two_lobes": [2e-5], "three_lobes": [0.0], "phase": [0.0]}
    twist = _offset("joint_axis_wobble", values, Q).base
    ideal = make_plant()
    pose = ideal.true_T_M_B("left")
    p_B = (ideal.smr_positions("left", Q) - pose[:3, 3]) @ pose[:3, :3]
    moved = p_B + twist[:, :3] + np.cross(twist[:, 3:], p_B)
    found = _positions(make_arm, make_plant, {"joint_axis_wobble": values})
    assert np.abs((found - pose[:3, 3]) @ pose[:3, :3] - moved).max() < 1e-7
    assert np.linalg.norm(moved - p_B, axis=1).max() > 1e-5


# -- laws outside the catalogue ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "values", "joint", "law"),
    [
        ("crosstalk", {"amplitude": 2e-4, "phase": 0.3}, 3, lambda q: 2e-4 * np.sin(3 * q[:, 4] + 0.3)),
        ("wrist_cable", {"amplitude": 1e-3, "phase": 0.3}, 5, lambda q: 1e-3 * np.sin(3 * q[:, 3] + 0.3)),
        (
            "dress_pack",
            {"torque": 6.0, "stiffness": 5e4, "first": 1.0, "second": -0.5, "centre": 0.2, "width": 0.4},
            0,
            lambda q: 1.2e-4 * np.tanh((q[:, 0] - 0.5 * q[:, 1] - 0.2) / 0.4),
        ),
    ],
)
def test_an_uncatalogued_effect_rotates_one_joint_by_others(make_arm, make_plant, name, values, joint, law):
    joints = Q.copy()
    joints[:, joint] += law(Q)
    found = _positions(make_arm, make_plant, {name: values})
    assert np.abs(found - make_plant().smr_positions("left", joints)).max() < 1e-13


def test_the_tool_sags_by_how_square_joint_5_stands(make_arm, make_plant):
    shift = [1e-4, -5e-5, 2e-5]
    q = np.tile(Q[0], (3, 1))
    q[:, 4] = 0.0, np.pi / 2, -np.pi / 6
    found = _positions(make_arm, make_plant, {"tool_sag": {"shift": shift}}, q)
    for k, share in enumerate((0.0, 1.0, 0.5)):
        other = make_arm(smr_offset=make_arm().smr_offset + share * np.array(shift))
        assert np.abs(found[k] - make_plant(other).smr_positions("left", q[[k]])[0]).max() < 1e-13


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"backlash": {"play": [1e-4] * 6, "reach": [0.0] * 6}}, "reach must be greater than 0"),
        (
            {"unsettled_measurement": {"fraction": [1e-4] * 6, "time_constant": 4.0}},
            "time_constant must be a list of 6",
        ),
        ({"transmission_error": {}}, "mode must be one of lines, curve, meshing, not None"),
        ({"transmission_error": GEAR | {"mode": "sines"}}, "mode must be one of lines, curve, meshing, not 'sines'"),
        ({"transmission_error": GEAR | {"ratio": [0.5]}}, "ratio must be at least 1"),
        ({"transmission_error": GEAR | {"eccentric": [1.5]}}, "eccentric must be less than 1, not 1.5"),
        ({"transmission_error": CURVE | {"rms": [1e-5]}}, "rms must be a list of 2 numbers"),
        ({"transmission_error": CURVE | {"seed": 1.5}}, "seed must be a whole number from 0 up, not 1.5"),
        ({"transmission_error": CURVE | {"lowest": 1}}, "lowest must be a whole number from 2 up, not 1"),
        ({"transmission_error": CURVE | {"highest": 4}}, "highest must be from lowest, 5, to 144, not 4"),
        ({"transmission_error": CURVE | {"highest": 145}}, "highest must be from lowest, 5, to 144, not 145"),
        ({"joint_axis_wobble": BEARING | {"radius": [0.0] * 2}}, "radius must be greater than 0"),
        ({"crosstalk": {"amplitude": 1e-4}}, "parameter 'phase' is missing; its parameters are amplitude, phase"),
        ({"dress_pack": {"torque": 1}}, "parameter 'stiffness' is missing"),
    ],
)
def test_a_wrong_parameter_is_one_clear_error(make_arm, make_plant, effects, message):
    with pytest.raises(ValueError, match=f"arm left, effect {next(iter(effects))}: .*{message}"):
        make_plant(make_arm(effects=effects))


@pytest.mark.parametrize(
    ("name", "values", "joints"),
    [
        ("crosstalk", {"amplitude": 1e-4, "phase": 0.0}, 4),
        ("wrist_cable", {"amplitude": 1e-4, "phase": 0.0}, 5),
        ("tool_sag", {"shift": [0.0] * 3}, 4),
    ],
)
def test_a_law_of_the_wrist_needs_a_wrist(name, values, joints):
    with pytest.raises(
        ValueError, match=f"effect {name}: .* needs an arm of at least {joints + 1} joints, not {joints}"
    ):
        FACTORIES[name](Parameters("left", name, values, joints))
