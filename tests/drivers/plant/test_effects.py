"""Hidden effects against their definitions in textbooks, and their parameters."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import root

from drivers.plant import ONLY_MOVING, OUTSIDE, REALISTIC, gravity_torques, suggest, suggest_other_law
from drivers.plant.effect import Parameters
from drivers.plant.effects import FACTORIES, build
from drivers.plant.mechanism import STANDARD_GRAVITY, Posture, nominal
from drivers.plant.random_functions import RandomField, RandomPaths

FAST = {"speed": np.full(6, 2.0), "acceleration": np.full(6, 3.0)}


def _go(plant, q):
    plant.start_move("left", np.asarray(q, dtype=float), **FAST)
    plant.advance(max(plant.rest_s("left") - plant.clock_s, 0.0))


def test_the_eccentric_disc_reads_the_commanded_angle(make_arm, make_plant):
    """The head's reading, computed from the true shaft angle, is the angle that the controller reports."""
    e, r, phase = 4e-4, 0.02, 0.7  # far too large, so that a mere sine would be seen
    values = {"joints": [1], "eccentricity": [e], "radius": [r], "phase": [phase]}
    arm = make_arm(effects={"encoder_eccentricity": values})
    q = np.zeros((73, 6))
    q[:, 0] = np.linspace(-2 * np.pi, 2 * np.pi, 73)
    plant = make_plant(arm)
    # joint 1 turns about the vertical through the base: the shaft angle shows in the azimuth about it
    around = [
        p.smr_positions("left", q) @ p.true_T_M_B("left")[:3, :3] - p.true_T_M_B("left")[:3, 3]
        for p in (plant, make_plant())
    ]
    bent, ideal = (np.arctan2(p[:, 1], p[:, 0]) for p in around)
    miss = (bent - ideal + np.pi) % (2 * np.pi) - np.pi
    shaft = q[:, 0] + miss
    reading = shaft + np.arctan2(e * np.sin(shaft + phase), r - e * np.cos(shaft + phase))
    assert np.abs(reading - q[:, 0]).max() < 1e-13
    assert np.abs(miss).max() == pytest.approx(e / r, rel=1e-3)


@settings(max_examples=30, deadline=None)
@given(goals=st.lists(st.integers(-6, 6), min_size=1, max_size=12), play=st.floats(1e-4, 0.3))
def test_play_drags_the_joint_behind_the_drive(make_arm, make_plant, goals, play):
    arm = make_arm(effects={"backlash": {"play": [play, 0, 0, 0, 0, 0]}})
    plant, ideal = make_plant(arm), make_plant()
    joint = 0.0
    for goal in goals:
        drive = 0.1 * goal
        _go(plant, [drive, 0, 0, 0, 0, 0])
        # dragged at the edge of the dead band, still inside it
        joint = max(min(joint, drive + play / 2), drive - play / 2)
        expected = ideal.smr_positions("left", np.array([[joint, 0, 0, 0, 0, 0]]))[0]
        assert np.abs(plant.targets()[0].p_M - expected).max() < 1e-12
        assert plant.q("left")[0] == drive


# -- Suggested parameters are valid, repeatable and of realistic size --------------------------------------------------

DURATION_S = 9000.0
STOPS = 40


@pytest.mark.parametrize("slug", REALISTIC + OUTSIDE)
def test_a_suggestion_is_an_effect_of_realistic_size(make_arm, make_plant, slug):
    rng = np.random.default_rng(7)
    for kind, other in (("ur10", "ur5"), ("ur5", "ur10")):
        left, right = make_arm(kind, "left", 0.0, smr_acceptance=0.6), make_arm(other, "right", 1.2)
        parameters = suggest(slug, rng, left, DURATION_S)
        # a profile or a sealed truth can hold it
        assert json.loads(json.dumps(parameters)) == parameters
        q, away = rng.uniform(-2.5, 2.5, (2, STOPS, 6))
        time_s = np.sort(rng.uniform(0.0, DURATION_S, STOPS))
        ideal = make_plant(left, right)
        told = {
            "others": {"right": away},
            "time_s": time_s,
            "last_step": rng.choice([-1.0, 1.0], (STOPS, 6)) * rng.uniform(0.1, 1.5, (STOPS, 6)),
            "since_rest_s": rng.uniform(1.0, 5.0, STOPS),
            "payload": rng.choice([0.5, 4.0], STOPS),
            "joints_c": 20.0 + 8.0 * (1.0 - np.exp(-time_s / 2400.0))[:, None] * rng.uniform(0.7, 1.3, 6),
        }
        plant = make_plant(replace(left, effects={slug: parameters}), right)
        moved = plant.smr_positions("left", q, **told) - ideal.smr_positions("left", q, **told)
        size = np.sqrt((moved**2).sum(axis=1).mean())
        assert 5e-6 < size < 5e-3


def test_every_effect_has_a_suggestion():
    groups = (REALISTIC, OUTSIDE, ONLY_MOVING)
    assert set().union(*groups) == set(FACTORIES)
    assert sum(map(len, groups)) == len(FACTORIES)


def test_parameters_are_valid_for_a_weightless_arm_of_seven_joints(seven_joints):
    rng = np.random.default_rng(0)
    for slug in REALISTIC + OUTSIDE:
        parameters = suggest(slug, rng, seven_joints, DURATION_S)
        assert len(build(seven_joints.name, seven_joints.joints, {slug: parameters})) == 1, slug
    for slug in REALISTIC:
        other = suggest_other_law(slug, rng, seven_joints, DURATION_S)
        FACTORIES[slug](Parameters("left", slug, other, 7))


def test_a_wrong_slug_or_duration_is_one_clear_error(make_arm):
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="unknown effect 'gremlins'; effects are backlash, base_drift"):
        suggest("gremlins", rng, make_arm(), DURATION_S)
    for duration_s in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="duration_s must be a positive time, not"):
            suggest("backlash", rng, make_arm(), duration_s)


# -- Drives, encoders and bearings, without loads ----------------------------------------------------------------------


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


# -- creep -------------------------------------------------------------------------------------------------------------


def test_the_rest_of_a_step_decays_at_rest(make_arm, make_plant):
    values = {"fraction": [1e-4] * 6, "time_constant": [4.0] * 6}
    step = np.random.default_rng(0).uniform(-2, 2, (8, 6))
    for rest, left in ((0.0, 1.0), (4.0, np.exp(-1.0)), (4.0 * np.log(2.0), 0.5), (np.inf, 0.0)):
        found = _positions(
            make_arm, make_plant, {"unsettled_measurement": values}, last_step=step, since_rest_s=np.full(8, rest)
        )
        assert np.abs(found - make_plant().smr_positions("left", Q - 1e-4 * left * step)).max() < 1e-12


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


CURVE = {"mode": "curve", "joints": [2, 3], "rms": [5e-5, 2e-5], "seed": 5, "lowest": 5, "highest": 40}


def test_the_curve_is_periodic_smooth_and_of_the_wanted_cycles():
    error = _offset("transmission_error", CURVE, _sweep(1)).joints[:, 1]
    assert np.sqrt((error**2).mean()) == pytest.approx(5e-5, rel=1e-3)
    power = np.abs(np.fft.rfft(error)) ** 2
    assert power[5:41].sum() > 0.9999 * power.sum()
    assert (power[5:41] > 1e-6 * power.max()).sum() > 25
    round_again = _offset("transmission_error", CURVE, _sweep(1) - 4 * np.pi).joints[:, 1]
    assert np.abs(round_again - error).max() < 1e-12


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


# -- Under load: analytic springs, beams and columns -------------------------------------------------------------------


DOWN = np.array([0.0, 0.0, -STANDARD_GRAVITY])


def _effect(name, values, joints=6):
    return FACTORIES[name](Parameters("left", name, values, joints))


# -- springs in the joints ---------------------------------------------------------------------------------------------


def test_under_the_load_each_drive_spring_balances_the_load_alone(make_arm, make_plant):
    stiffness = np.array([3e4, 4e4, 2e4, 8e3, 8e3, 8e3])
    center = np.array([0.05, -0.02, 0.1])
    found = _positions(
        make_arm,
        make_plant,
        {"payload_compliance": {"stiffness": stiffness.tolist()}},
        payload=np.full(8, 6.0),
        payload_center=center,
    )
    loaded, bare = make_arm(payload_mass=6.0, payload_center=center), make_arm()
    joints = Q.copy()
    for _ in range(30):
        joints = Q + (gravity_torques(loaded, joints) - gravity_torques(bare, joints)) / stiffness
    assert np.abs(joints - Q).max() > 1e-3
    assert np.abs(found - make_plant().smr_positions("left", joints)).max() < 1e-11


def test_a_drive_is_soft_up_to_the_knee_and_stiffer_beyond(make_arm, make_plant):
    stiff, soft, knee = np.full(6, 5e4), np.full(6, 3e4), np.array([10.0, 30.0, 8.0, 1.0, 0.2, 0.1])
    values = {"stiffness": stiff.tolist(), "soft_stiffness": soft.tolist(), "knee": knee.tolist()}
    found = _positions(make_arm, make_plant, {"joint_compliance": values})
    joints = Q.copy()
    for _ in range(40):
        torque = gravity_torques(make_arm(), joints)
        beyond = np.maximum(np.abs(torque) - knee, 0.0)
        joints = Q + np.sign(torque) * ((np.abs(torque) - beyond) / soft + beyond / stiff)
    assert (np.abs(torque) > knee).any()
    assert (np.abs(torque) < knee).any()
    assert np.abs(found - make_plant().smr_positions("left", joints)).max() < 1e-11


def test_friction_winds_the_drive_up_against_the_last_motion(make_arm, make_plant):
    values = {"friction": [5.0] * 6, "load_friction": [0.0] * 6, "stiffness": [5e4] * 6}
    side = np.random.default_rng(0).choice([-1.0, 1.0], (8, 6))
    found = _positions(make_arm, make_plant, {"friction_windup": values}, approach=side)
    assert np.abs(found - make_plant().smr_positions("left", Q - side * 1e-4)).max() < 1e-12
    unmoved = _positions(make_arm, make_plant, {"friction_windup": values})
    assert np.array_equal(unmoved, make_plant().smr_positions("left", Q))


def test_friction_grows_with_the_load_on_the_joint(make_arm, make_plant):
    values = {"friction": [0.0] * 6, "load_friction": [0.1] * 6, "stiffness": [5e4] * 6}
    side = np.ones((8, 6))
    found = _positions(make_arm, make_plant, {"friction_windup": values}, approach=side, payload=np.full(8, 7.0))
    joints = Q.copy()
    for _ in range(20):
        joints = Q - 0.1 * np.abs(gravity_torques(make_arm(payload_mass=7.0), joints)) / 5e4
    assert np.abs(found - make_plant().smr_positions("left", joints)).max() < 1e-12


# -- beams -------------------------------------------------------------------------------------------------------------

LENGTH, EI, GJ = 0.612, 8e4, 6e4  # of the UR10's upper arm
LEVEL = np.zeros((1, 6))  # both beams lie level, along -x of B


def _tip(arm, links=(2,), bending=EI, torsion=GJ, q=LEVEL):
    """Twist of the first of ``links`` as it bends at ``q``, turned into B: shift and rotation vector."""
    effect = _effect(
        "link_bending",
        {"links": list(links), "bending": [bending] * len(links), "torsion": [torsion] * len(links)},
    )
    posture = Posture(nominal(arm), q, DOWN)
    twist = effect.bend(SimpleNamespace(), posture).links[0, links[0] - 1]
    turn = (posture.placements[links[0] - 1] @ posture.mechanism.frames[links[0]])[0, :3, :3]
    return turn @ twist[:3], turn @ twist[3:]


def _only(make_arm, **bodies):
    """An arm whose bodies weigh nothing but those named: ``_2=(mass, centre)``."""
    masses, centers = np.zeros(6), np.zeros((6, 3))
    for name, (mass, center) in bodies.items():
        number = int(name[1:]) - 1
        masses[number], centers[number] = mass, center
    return make_arm(masses=masses, centers_of_mass=centers)


def test_a_weight_at_the_tip_bends_the_beam_as_a_cantilever(make_arm):
    arm = _only(make_arm, _3=(5.0, [0.5723, 0.0, 0.0]))  # a body that hangs at the tip of link 2
    shift, turn = _tip(arm)
    force = 5.0 * STANDARD_GRAVITY
    # a beam of 12 segments is a little softer than a smooth one: 1 / (8 * 144) of it
    assert shift[2] == pytest.approx(-force * LENGTH**3 / (3 * EI), rel=3e-3)
    assert np.linalg.norm(turn) == pytest.approx(force * LENGTH**2 / (2 * EI), rel=3e-3)
    assert turn[1] < 0.0  # the tip, at -x, sinks: a turn about -y
    assert np.abs(turn[[0, 2]]).max() < 1e-12


def test_a_weight_beside_the_beam_twists_it(make_arm):
    aside = 0.15
    arm = _only(make_arm, _3=(5.0, [0.5723, 0.0, aside]))  # z of the frame lies level, across the beam
    _, turn = _tip(arm)
    assert np.abs(turn[0]) == pytest.approx(5.0 * STANDARD_GRAVITY * aside * LENGTH / GJ, rel=1e-9)


def test_own_weight_bends_the_beam_like_a_distributed_load(make_arm):
    arm = _only(make_arm, _2=(12.0, [LENGTH / 2, 0.0, 0.0]))
    shift, turn = _tip(arm)
    load = 12.0 * STANDARD_GRAVITY / LENGTH
    assert shift[2] == pytest.approx(-load * LENGTH**4 / (8 * EI), rel=1e-2)
    assert -turn[1] == pytest.approx(load * LENGTH**3 / (6 * EI), rel=1e-2)


# -- what the arm stands on --------------------------------------------------------------------------------------------


def test_the_column_bends_as_a_cantilever_under_the_moment_of_the_arm(make_arm):
    arm = _only(make_arm, _3=(10.0, [0.0, 0.0, 0.0]))
    posture = Posture(nominal(arm), LEVEL, DOWN)
    height, bending = 0.8, 2e6
    values = {"height": height, "bending": [bending, bending], "torsion": 3e6}
    base = _effect("pedestal_compliance", values).bend(SimpleNamespace(), posture).base[0]
    moment = 10.0 * STANDARD_GRAVITY * (0.612 + 0.5723)
    assert base[4] == pytest.approx(-moment / bending)  # the weight hangs at -x
    assert base[0] == pytest.approx(-moment / bending * height / 2)
    assert np.abs(base[[2, 3, 5]]).max() < 1e-15


COUPLING = {"bending": 2e6, "torsion": 2e6, "depth": 0.0}


def test_the_moment_of_the_other_arm_turns_this_base(make_arm, make_plant):
    right = make_arm("ur5", "right", 1.2)
    plant = make_plant(make_arm(effects={"pedestal_coupling": COUPLING}), right)
    other = np.random.default_rng(2).uniform(-2, 2, (8, 6))
    moment = Posture(nominal(right), other, DOWN).base_moment
    found = plant.smr_positions("left", Q, others={"right": other})
    T_M_B = plant.true_T_M_B("left")
    p_B = (plant_free(make_plant, make_arm, right).smr_positions("left", Q) - T_M_B[:3, 3]) @ T_M_B[:3, :3]
    turned = p_B + np.cross(moment / 2e6, p_B)
    assert np.abs(found - (turned @ T_M_B[:3, :3].T + T_M_B[:3, 3])).max() < 5e-9
    # it depends on nothing else of the other arm, and a weightless one turns nothing
    light = make_arm("ur5", "right", 1.2, masses=np.zeros(6))
    still = make_plant(make_arm(effects={"pedestal_coupling": COUPLING}), light)
    assert np.array_equal(
        still.smr_positions("left", Q, others={"right": other}),
        plant_free(make_plant, make_arm, light).smr_positions("left", Q),
    )


def plant_free(make_plant, make_arm, right):
    """The same two arms without the effect."""
    return make_plant(make_arm(), right)


def test_a_stiffness_without_equilibrium_is_refused(make_arm, make_plant):
    with pytest.raises(ValueError, match="arm left: the hidden effects reach no equilibrium"):
        _positions(make_arm, make_plant, {"payload_compliance": {"stiffness": [1.0] * 6}}, payload=np.full(8, 10.0))


# -- Gravity torques and elastic joints --------------------------------------------------------------------------------


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


# -- The tracker and its target: scale, zero, circles, axes, glass -----------------------------------------------------


P = np.random.default_rng(0).uniform(-1.0, 1.0, (30, 3)) * [2.0, 2.0, 1.0] + [0.0, 3.0, 0.2]
NO_CIRCLE = [0.0, 0.0, 0.0, 0.0]


SITUATION: Any = SimpleNamespace()
"""These effects do not depend on the situation."""


def _apparent(name, values, p_M=P, normal_M=None):
    effect = FACTORIES[name](Parameters("left", name, values, 6))
    normal_M = -p_M / np.linalg.norm(p_M, axis=1, keepdims=True) if normal_M is None else normal_M
    return effect.apparent_position(p_M, normal_M, SITUATION)


def _angles(p_M):
    return np.stack([np.arctan2(p_M[:, 1], p_M[:, 0]), np.arctan2(p_M[:, 2], np.hypot(p_M[:, 0], p_M[:, 1]))])


def _distance(p_M):
    return np.linalg.norm(p_M, axis=1)


def test_wrong_air_makes_all_distances_longer_by_the_same_share():
    assert _distance(_apparent("tracker_scale", {"ppm": 5.0})) == pytest.approx(_distance(P) * (1 + 5e-6), rel=1e-14)
    assert _angles(_apparent("tracker_scale", {"ppm": -5.0})) == pytest.approx(_angles(P), abs=1e-14)


def test_a_wrong_zero_makes_all_distances_longer_by_the_same_length():
    seen = _apparent("tracker_distance_offset", {"offset": -2e-5})
    assert _distance(seen) - _distance(P) == pytest.approx(np.full(30, -2e-5), abs=1e-14)
    assert _angles(seen) == pytest.approx(_angles(P), abs=1e-14)


@pytest.mark.parametrize("axis", [0, 1])
def test_an_eccentric_circle_is_read_once_a_turn_and_a_slanted_one_twice(axis):
    key = ("azimuth", "elevation")[axis]
    clean = {"azimuth": NO_CIRCLE, "elevation": NO_CIRCLE, "transit": 0.0}
    angle = _angles(P)[axis]
    for circle, expected in (
        ([1e-5, 0.3, 0.0, 0.0], 1e-5 * np.sin(angle + 0.3)),
        ([0.0, 0.0, 8e-3, 0.7], 8e-3**2 / 4 * np.sin(2 * (angle + 0.7))),
    ):
        seen = _apparent("tracker_angle_error", clean | {key: circle})
        assert _angles(seen)[axis] - angle == pytest.approx(expected, abs=2e-9)
        assert _angles(seen)[1 - axis] == pytest.approx(_angles(P)[1 - axis], abs=1e-14)
        assert _distance(seen) == pytest.approx(_distance(P), rel=1e-14)


def test_a_slanted_transit_axis_points_where_its_readings_turn_it():
    slant = 0.05
    seen = _apparent("tracker_angle_error", {"azimuth": NO_CIRCLE, "elevation": NO_CIRCLE, "transit": slant})
    azimuth, elevation = _angles(seen)
    # turn the beam up about the level axis, slant that axis about the beam's level direction, turn to the azimuth
    beam = np.stack([np.cos(elevation), np.zeros(30), np.sin(elevation)])
    c, s = np.cos(slant), np.sin(slant)
    beam = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ beam
    x, y = np.cos(azimuth) * beam[0] - np.sin(azimuth) * beam[1], np.sin(azimuth) * beam[0] + np.cos(azimuth) * beam[1]
    assert np.abs(np.stack([x, y, beam[2]], axis=1) * _distance(P)[:, None] - P).max() < 1e-14


GLASS = {"thickness": 3e-4, "index": 1.51, "dihedral": 0.0}


def _turned(angle, about):
    """Normals that look to the tracker and are then turned away by ``angle`` (n,) towards ``about`` (n, 3)."""
    back = -P / _distance(P)[:, None]
    side = np.cross(back, about)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return np.cos(angle)[:, None] * back + np.sin(angle)[:, None] * side


def test_the_path_through_the_glass_follows_snells_law():
    angle = np.linspace(0.0, 1.0, 30)
    seen = _apparent("target_incidence", GLASS, normal_M=_turned(angle, np.array([0.0, 0.0, 1.0])))
    inside = np.arcsin(np.sin(angle) / 1.51)
    # path in the glass, its part along the beam's way in air taken off (optical), against the square one
    path = 3e-4 * (1.51 / np.cos(inside) - np.cos(angle - inside) / np.cos(inside))
    assert _distance(seen) - _distance(P) == pytest.approx(path - 3e-4 * 0.51, abs=1e-12)
    assert (np.diff(_distance(seen) - _distance(P)) > 0.0).all()
    assert _angles(seen) == pytest.approx(_angles(P), abs=1e-14)
    other_side = _apparent("target_incidence", GLASS, normal_M=_turned(angle, np.array([0.0, 1.0, 0.3])))
    assert _distance(other_side) == pytest.approx(_distance(seen), abs=1e-14)


def test_a_dihedral_error_deflects_the_beam_in_proportion_to_distance():
    angle = np.linspace(0.0, 0.6, 30)
    normal = _turned(angle, np.array([0.0, 0.0, 1.0]))
    moved = _apparent("target_incidence", GLASS | {"thickness": 0.0, "dihedral": 2e-6}, normal_M=normal) - P
    assert np.linalg.norm(moved, axis=1) == pytest.approx(2e-6 * _distance(P) * np.sin(angle), abs=1e-14)
    assert np.abs((moved * P).sum(axis=1)).max() < 1e-14


def test_in_the_cell_the_tracker_sees_the_arm_through_them(make_arm, make_plant):
    q = np.random.default_rng(1).uniform(-2, 2, (5, 6))
    effects = {"tracker_scale": {"ppm": 10.0}, "tracker_distance_offset": {"offset": 3e-5}}
    plant, ideal = make_plant(make_arm(effects=effects)), make_plant()
    p_M = ideal.smr_positions("left", q)
    moved = plant.smr_positions("left", q) - p_M
    along = p_M / _distance(p_M)[:, None]
    assert np.abs(moved - along * (1e-5 * _distance(p_M) + 3e-5)[:, None]).max() < 1e-9
    live = plant.targets()[0].p_M - ideal.targets()[0].p_M
    assert np.linalg.norm(live) == pytest.approx(1e-5 * np.linalg.norm(ideal.targets()[0].p_M) + 3e-5, rel=1e-4)


# -- Laws of another shape: each has the usual law as its limit, and its own equation holds ----------------------------


STOPS_OF_OTHER_LAWS = 30
STIFF = [5e4, 4e4, 3e4, 1e4, 1e4, 1e4]
WOUND = {"friction": [4.0] * 6, "load_friction": [0.0] * 6, "stiffness": STIFF}
GROWTH = {"expansion": 2.3e-5, "share": 0.8, "lag": 900.0, "motor": 1e-6}
WALK = {"shift": [5e-5, 2e-5, -3e-5], "turn": [1e-5, -2e-5, 3e-5]}
SETTLING = {"fraction": [1e-4] * 6, "time_constant": [4.0] * 6}
CIRCLES = {"azimuth": [1e-5, 0.2, 6e-3, 1.0], "elevation": [8e-6, 2.0, 5e-3, 0.3], "transit": 1e-5}
COLUMN = {"height": 0.0, "bending": [1e6, 1e6], "torsion": 2e6}
GENERATOR = {"ratio": [80.0], "line": [5e-5], "line_phase": [0.3], "depth_phase": [1.0], "second_cycles": [11.5],
             "second_phase": [0.7]}  # fmt: skip


@pytest.fixture(scope="module")
def situation():
    """Stops of a run, as keywords of ``smr_positions``, and the joint positions (n, 6) [rad] under ``q``."""
    rng = np.random.default_rng(3)
    time_s = np.sort(rng.uniform(0.0, DURATION_S, STOPS_OF_OTHER_LAWS))
    return {
        "q": rng.uniform(-2.5, 2.5, (STOPS_OF_OTHER_LAWS, 6)),
        "time_s": time_s,
        "last_step": rng.choice([-1.0, 1.0], (STOPS_OF_OTHER_LAWS, 6))
        * rng.uniform(0.1, 2.0, (STOPS_OF_OTHER_LAWS, 6)),
        "since_rest_s": rng.uniform(1.0, 6.0, STOPS_OF_OTHER_LAWS),
        "payload": rng.choice([0.5, 6.0], STOPS_OF_OTHER_LAWS),
        "joints_c": 20.0 + 10.0 * (1.0 - np.exp(-time_s / 2400.0))[:, None] * rng.uniform(0.7, 1.3, 6),
        "air_c": 20.0 + rng.uniform(-1.0, 1.0, STOPS_OF_OTHER_LAWS),
    }


@pytest.fixture
def positions(make_arm, make_plant, situation):
    """``positions(effects, **changes)``: SMR positions (n, 3) [m] of an arm with these effects beside another arm."""

    def measured(effects, **changes):
        right = make_arm("ur5", "right", 1.2)
        told = situation | {"others": {"right": situation["q"][::-1].copy()}} | changes
        return make_plant(make_arm(effects=effects), right).smr_positions("left", told.pop("q"), **told)

    return measured


LIMITS = [
    ("joint_compliance", {"law": "hardening", "stiffness": STIFF, "cubic": [1.0] * 6}, {"stiffness": STIFF}),
    ("joint_compliance", {"law": "stiffening", "stiffness": STIFF, "soft_stiffness": STIFF, "knee": [9.0] * 6},
     {"stiffness": STIFF}),
    ("joint_compliance", {"law": "three_stage", "first": STIFF, "second": STIFF, "third": STIFF,
                          "first_knee": [5.0] * 6, "second_knee": [20.0] * 6}, {"stiffness": STIFF}),
    ("payload_compliance", {"law": "off_centre", "stiffness": STIFF, "shift": [0.0] * 3}, {"stiffness": STIFF}),
    ("payload_compliance", {"law": "softening", "stiffness": STIFF, "soft_stiffness": STIFF, "knee": [5.0] * 6},
     {"stiffness": STIFF}),
    ("link_bending", {"law": "shear", "links": [2], "bending": [1e5], "torsion": [8e4], "shear": [np.inf]},
     {"links": [2], "bending": [1e5], "torsion": [8e4]}),
    ("encoder_eccentricity",
     {"law": "tilted", "joints": [2], "eccentricity": [2e-6], "radius": [0.025], "phase": [0.4], "tilt": [0.0],
      "tilt_phase": [1.0]},
     {"joints": [2], "eccentricity": [2e-6], "radius": [0.025], "phase": [0.4]}),
    ("transmission_error", {"mode": "meshing", "joints": [1], **GENERATOR, "depth": [0.0], "second": [0.0]},
     {"mode": "meshing", "joints": [1], **GENERATOR, "depth": [0.0], "second": [0.0], "second_cycles": [3.0]}),
    ("friction_windup", {"law": "stribeck", **WOUND, "rise": 0.0, "short": 0.5}, WOUND),
    ("friction_windup", {"law": "root_load", **WOUND, "typical_load": [10.0] * 6}, WOUND),
    ("unsettled_measurement", {"law": "two_rates", **SETTLING, "slow_time_constant": [30.0] * 6, "slow_share": 0.0},
     SETTLING),
    ("thermal_growth", {"law": "two_lags", **GROWTH, "slow_lag": 5000.0, "slow_share": 0.0}, GROWTH),
    ("thermal_growth", {"law": "saturating", **GROWTH, "limit": 1e6}, GROWTH),
    ("base_step", {"law": "creeping", **WALK, "time": 4000.0, "creeping": 0.0, "time_constant": 100.0},
     {**WALK, "time": 4000.0}),
    ("target_slip", {"law": "creeping", "shift": [1e-4, 0.0, 5e-5], "time": 4000.0, "creeping": 0.0,
                     "time_constant": 100.0}, {"shift": [1e-4, 0.0, 5e-5], "time": 4000.0}),
    ("pedestal_compliance", {"law": "frame", "pivot": [0.0] * 3, "direct": [1e-6, 1e-6, 5e-7], "cross": [0.0] * 3},
     COLUMN),
    ("pedestal_coupling", {"law": "hardening", "bending": 2e6, "torsion": 1e6, "depth": 0.4, "limit": 1e12},
     {"bending": 2e6, "torsion": 1e6, "depth": 0.4}),
    ("tracker_scale", {"law": "air", "ppm": 5.0, "per_kelvin": 0.0}, {"ppm": 5.0}),
    ("tracker_distance_offset", {"law": "growing", "offset": 2e-5, "length": 1e-3}, {"offset": 2e-5}),
    ("tracker_angle_error", {"law": "higher", **CIRCLES, "azimuth_higher": [0.0] * 4, "elevation_higher": [0.0] * 4},
     CIRCLES),
]  # fmt: skip


@pytest.mark.parametrize(
    ("effect", "other", "usual"), LIMITS, ids=lambda value: value if isinstance(value, str) else ""
)
def test_the_usual_law_is_a_limit_of_the_other(positions, effect, other, usual):
    moved = positions({effect: usual}) - positions({})
    assert np.abs(positions({effect: other}) - positions({effect: usual})).max() < 1e-5 * np.abs(moved).max() + 1e-12


def test_a_warm_gear_has_more_play(positions):
    values = {"law": "warm", "play": [1e-4] * 6, "reach": [0.1] * 6, "per_kelvin": 0.05}
    cold, warm = (
        positions({"backlash": values}, joints_c=np.full(6, t)) - positions({}, joints_c=np.full(6, t))
        for t in (20.0, 30.0)
    )
    assert np.linalg.norm(warm) == pytest.approx(1.5 * np.linalg.norm(cold), rel=1e-3)


def test_the_hardening_spring_balances_the_load(make_arm, positions, situation):
    stiffness, cubic = np.array(STIFF), 0.3 * np.array(STIFF) ** 3 / 50.0**2
    values = {"law": "hardening", "stiffness": STIFF, "cubic": cubic.tolist()}
    alone = {"payload": np.zeros(STOPS_OF_OTHER_LAWS)}
    found = positions({"joint_compliance": values}, **alone)
    turned = np.zeros((STOPS_OF_OTHER_LAWS, 6))
    for _ in range(60):  # Newton's method on the spring, beside the equilibrium of the posture
        torque = gravity_torques(make_arm(), situation["q"] + turned)
        turned -= (stiffness * turned + cubic * turned**3 - torque) / (stiffness + 3.0 * cubic * turned**2)
    assert np.abs(found - positions({}, q=situation["q"] + turned, **alone)).max() < 1e-10


def test_many_plays_follow_their_history_in_a_batch_as_in_motion(make_arm, make_plant):
    values = {"law": "many_plays", "play": [1e-3] * 6, "reach": [0.5] * 6}
    plant = make_plant(make_arm(effects={"backlash": values}))
    stops = np.cumsum(np.random.default_rng(2).uniform(-0.6, 0.6, (12, 6)), axis=0)
    moved = []
    for q in stops:
        plant.start_move("left", q, np.full(6, 2.0), np.full(6, 3.0))
        plant.advance(max(plant.rest_s("left") - plant.clock_s, 0.0))
        moved.append(plant.targets()[0].p_M)
    steps = np.diff(stops, axis=0, prepend=np.zeros((1, 6)))
    found = plant.smr_positions("left", stops, last_step=steps, time_s=np.arange(12.0))
    assert np.abs(found - np.array(moved)).max() < 1e-11
    ideal = make_plant().smr_positions("left", stops)
    assert np.abs(found - ideal).max() > 1e-5


def test_a_wandering_drift_starts_at_zero_and_has_its_size():
    paths = RandomPaths.drawn(5, 400, 1000.0)
    assert np.abs(paths.at(np.zeros(1))).max() < 1e-12
    long = paths.at(np.linspace(0.0, 5e5, 3000))
    assert (long - long.mean(axis=0)).std() == pytest.approx(1.0, rel=0.1)
    times = np.array([4000.0, 4010.0])
    assert np.abs(np.diff(paths.at(times), axis=0)).max() < 0.1, "it is smooth"


def test_a_field_is_smooth_and_has_its_size():
    fields = [RandomField.drawn(seed, 0.5) for seed in range(300)]
    here, near, far = np.zeros((1, 3)), np.array([[0.05, 0.0, 0.0]]), np.array([[3.0, 0.0, 0.0]])
    values = np.array([[field.at(p)[0] for p in (here, near, far)] for field in fields])
    assert values[:, 0].std() == pytest.approx(1.0, rel=0.1)
    assert np.mean(values[:, 0] * values[:, 1]) == pytest.approx(np.exp(-0.5 * 0.1**2), abs=0.1)
    assert np.mean(values[:, 0] * values[:, 2]) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("slug", REALISTIC)
def test_other_laws_are_valid_repeatable_and_of_realistic_size(make_arm, positions, slug):
    arm = make_arm()
    one, again = (suggest_other_law(slug, np.random.default_rng(8), arm, DURATION_S) for _ in range(2))
    assert one == again == json.loads(json.dumps(one))
    assert one != suggest(slug, np.random.default_rng(8), arm, DURATION_S)
    for seed in range(6):
        parameters = suggest_other_law(slug, np.random.default_rng(seed), arm, DURATION_S)
        size = np.sqrt(((positions({slug: parameters}) - positions({})) ** 2).sum(axis=1).mean())
        assert 3e-6 < size < 8e-3


def test_an_effect_without_another_law_is_refused(make_arm):
    with pytest.raises(ValueError, match="effect 'draught' has no other law; those that have are backlash"):
        suggest_other_law("draught", np.random.default_rng(0), make_arm())


# -- Wrong parameters --------------------------------------------------------------------------------------------------

DISC = {"joints": [2], "eccentricity": [2e-6], "radius": [0.025], "phase": [0.0]}
TILT = {"stiffness": [1e4] * 6}
WRONG: list[tuple[str, object, str]] = [
    ("gremlins", {}, "unknown effect 'gremlins'; effects are backlash, base_drift"),
    ("backlash", {"plays": [0] * 6}, "unknown parameter 'plays'; its .* are play"),
    ("backlash", {}, "parameter 'play' is missing"),
    ("backlash", [1], "expected its parameters by name"),
    ("backlash", {"play": 1e-4}, "play must be a list of 6 numbers, not 0.0001"),
    ("backlash", {"play": ["1 deg"] * 6}, "play must hold numbers in SI units, not '1 deg'"),
    ("backlash", {"play": [float("nan")] * 6}, "play must hold numbers in SI units, not nan"),
    ("backlash", {"play": [-1e-4] * 6}, "play must be at least 0, not -0.0001"),
    ("backlash", {"play": [1e-4] * 6, "reach": [0.0] * 6}, "reach must be greater than 0"),
    ("backlash", {"law": "loose", "play": [0.0] * 6}, "law must be one of play, warm, many_plays, not 'loose'"),
    ("joint_compliance", TILT | {"knee": [1] * 6}, "soft_stiffness, knee belong together, but only knee is given"),
    ("joint_compliance", TILT | {"soft_stiffness": [2e4] * 6, "knee": [1] * 6}, "not be greater than stiffness"),
    ("encoder_eccentricity", DISC | {"joints": [7]}, "different joint numbers from 1 to 6, not \\[7\\]"),
    ("encoder_eccentricity", DISC | {"radius": [1e-6]}, "eccentricity must be smaller than radius"),
    ("transmission_error", {}, "mode must be one of lines, curve, meshing, not None"),
    ("transmission_error", GEAR | {"eccentric": [1.5]}, "eccentric must be less than 1, not 1.5"),
    ("transmission_error", CURVE | {"seed": 1.5}, "seed must be a whole number from 0 up, not 1.5"),
    ("transmission_error", CURVE | {"lowest": 1}, "lowest must be a whole number from 2 up, not 1"),
    ("transmission_error", CURVE | {"highest": 145}, "highest must be from lowest, 5, to 144, not 145"),
    ("pedestal_coupling", COUPLING | {"depth": "1 m"}, "depth must be a number in SI units, not '1 m'"),
    ("pedestal_compliance", {"law": "frame", "pivot": [0.0] * 3, "direct": [1e-6] * 3, "cross": [2e-6, 0.0, 0.0]},
     "cross must be smaller"),
    ("thermal_growth", GROWTH | {"share": 1.5}, "share must be from 0 to 1, not 1.5"),
    ("tracker_angle_error", CIRCLES | {"elevation": [-1e-5, 0, 0, 0]}, "elevation must have eccentric and slant"),
    ("tracker_angle_error", CIRCLES | {"transit": 1.0}, "transit must be a small angle, less than 0.1 rad, not 1"),
    ("target_incidence", GLASS | {"index": 0.9}, "index must be at least 1, not 0.9"),
    ("joint_axis_runout", {"joints": [1], "radial": [1e-5], "axial": [0.0], "harmonics": [], "shares": [], "seed": 1},
     "harmonics must be a list of numbers"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("effect", "parameters", "message"), WRONG, ids=lambda one: one if isinstance(one, str) else ""
)
def test_a_wrong_effect_is_one_clear_error(make_arm, make_plant, effect, parameters, message):
    with pytest.raises(ValueError, match=f"arm left.*{message}"):
        make_plant(make_arm(effects={effect: parameters}))


@pytest.mark.parametrize(("name", "joints"), [("crosstalk", 4), ("wrist_cable", 5)])
def test_a_law_of_the_wrist_needs_a_wrist(name, joints):
    values = {"amplitude": 1e-4, "phase": 0.0}
    with pytest.raises(ValueError, match=f"effect {name}: .* at least {joints + 1} joints, not {joints}"):
        FACTORIES[name](Parameters("left", name, values, joints))
