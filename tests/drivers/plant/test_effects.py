"""Hidden effects against their definitions in textbooks, and their parameters."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import root

from drivers.plant import ONLY_MOVING, OUTSIDE, REALISTIC, gravity_torques, suggest, suggest_other_law
from drivers.plant.effect import Parameters
from drivers.plant.effects import FACTORIES, build
from drivers.plant.mechanism import STANDARD_GRAVITY
from drivers.plant.random_functions import RandomField, RandomPaths
from tests.approved import assert_refused
from tests.arms import dh_frames

FAST = {"speed": np.full(6, 2.0), "acceleration": np.full(6, 3.0)}


def _go(plant, q):
    plant.start_move("left", np.asarray(q, dtype=float), **FAST)
    plant.advance(max(plant.rest_s("left") - plant.clock_s, 0.0))


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
        assert 5e-6 < _size(make_plant, left, right, {slug: parameters}) < 5e-3


def _size(make_plant, left, right, effects):
    """Rms of what effects move the left arm's SMR by [m], at random stops of a run of both arms."""
    rng = np.random.default_rng(3)
    q, away = rng.uniform(-2.5, 2.5, (2, STOPS, 6))
    time_s = np.sort(rng.uniform(0.0, DURATION_S, STOPS))
    told = {
        "others": {"right": away},
        "time_s": time_s,
        "last_step": rng.choice([-1.0, 1.0], (STOPS, 6)) * rng.uniform(0.1, 2.0, (STOPS, 6)),
        "since_rest_s": rng.uniform(1.0, 6.0, STOPS),
        "payload": rng.choice([0.5, 6.0], STOPS),
        "joints_c": 20.0 + 10.0 * (1.0 - np.exp(-time_s / 2400.0))[:, None] * rng.uniform(0.7, 1.3, 6),
        "air_c": 20.0 + rng.uniform(-1.0, 1.0, STOPS),
    }
    plant, ideal = make_plant(replace(left, effects=effects), right), make_plant(left, right)
    moved = plant.smr_positions("left", q, **told) - ideal.smr_positions("left", q, **told)
    return np.sqrt((moved**2).sum(axis=1).mean())


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


def _positions(make_arm, make_plant, effects, **situation):
    return make_plant(make_arm(effects=effects)).smr_positions("left", Q, **situation)


# -- lost motion that saturates ----------------------------------------------------------------------------------------


def test_given_steps_agree_with_executed_steps(make_arm, make_plant):
    effects = {
        "backlash": {"play": [2e-4] * 6, "reach": [0.2] * 6},
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


def test_a_stiffness_without_equilibrium_is_refused(make_arm, make_plant):
    with pytest.raises(ValueError, match="arm left: the hidden effects reach no equilibrium"):
        _positions(make_arm, make_plant, {"payload_compliance": {"stiffness": [1.0] * 6}}, payload=np.full(8, 10.0))


# -- Gravity torques and elastic joints --------------------------------------------------------------------------------


@pytest.mark.parametrize("payload", [0.0, 4.0])
def test_the_torque_is_the_slope_of_the_potential_energy(make_arm, payload):
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


# -- The tracker -------------------------------------------------------------------------------------------------------


def test_in_the_cell_the_tracker_sees_the_arm_through_them(make_arm, make_plant):
    q = np.random.default_rng(1).uniform(-2, 2, (5, 6))
    effects = {"tracker_scale": {"ppm": 10.0}, "tracker_distance_offset": {"offset": 3e-5}}
    plant, ideal = make_plant(make_arm(effects=effects)), make_plant()
    p_M = ideal.smr_positions("left", q)
    moved = plant.smr_positions("left", q) - p_M
    distance = np.linalg.norm(p_M, axis=1, keepdims=True)
    assert np.abs(moved - p_M / distance * (1e-5 * distance + 3e-5)).max() < 1e-9
    live = plant.targets()[0].p_M - ideal.targets()[0].p_M
    assert np.linalg.norm(live) == pytest.approx(1e-5 * np.linalg.norm(ideal.targets()[0].p_M) + 3e-5, rel=1e-4)


# -- Laws of another shape: each has the usual law as its limit, and its own equation holds ----------------------------


def test_many_plays_follow_their_history_in_a_batch_as_in_motion(make_arm, make_plant):
    values = {"law": "many_plays", "play": [1e-3] * 6, "reach": [0.5] * 6}
    plant = make_plant(make_arm(effects={"backlash": values}))
    stops = np.cumsum(np.random.default_rng(2).uniform(-0.6, 0.6, (12, 6)), axis=0)
    moved = []
    for q in stops:
        _go(plant, q)
        moved.append(plant.targets()[0].p_M)
    steps = np.diff(stops, axis=0, prepend=np.zeros((1, 6)))
    found = plant.smr_positions("left", stops, last_step=steps, time_s=np.arange(12.0))
    assert np.abs(found - np.array(moved)).max() < 1e-11
    ideal = make_plant().smr_positions("left", stops)
    assert np.abs(found - ideal).max() > 1e-5


def test_a_wandering_drift_starts_at_zero_and_has_its_size():
    paths = RandomPaths.sampled(5, 400, 1000.0)
    assert np.abs(paths.at(np.zeros(1))).max() < 1e-12
    long = paths.at(np.linspace(0.0, 5e5, 3000))
    assert (long - long.mean(axis=0)).std() == pytest.approx(1.0, rel=0.1)
    times = np.array([4000.0, 4010.0])
    assert np.abs(np.diff(paths.at(times), axis=0)).max() < 0.1, "it is smooth"


def test_a_field_is_smooth_and_has_its_size():
    fields = [RandomField.sampled(seed, 0.5) for seed in range(300)]
    here, near, far = np.zeros((1, 3)), np.array([[0.05, 0.0, 0.0]]), np.array([[3.0, 0.0, 0.0]])
    values = np.array([[field.at(p)[0] for p in (here, near, far)] for field in fields])
    assert values[:, 0].std() == pytest.approx(1.0, rel=0.1)
    assert np.mean(values[:, 0] * values[:, 1]) == pytest.approx(np.exp(-0.5 * 0.1**2), abs=0.1)
    assert np.mean(values[:, 0] * values[:, 2]) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("slug", REALISTIC)
def test_other_laws_are_valid_repeatable_and_of_realistic_size(make_arm, make_plant, slug):
    arm, right = make_arm(), make_arm("ur5", "right", 1.2)
    one, again = (suggest_other_law(slug, np.random.default_rng(8), arm, DURATION_S) for _ in range(2))
    assert one == again == json.loads(json.dumps(one))
    assert one != suggest(slug, np.random.default_rng(8), arm, DURATION_S)
    for seed in range(6):
        parameters = suggest_other_law(slug, np.random.default_rng(seed), arm, DURATION_S)
        assert 3e-6 < _size(make_plant, arm, right, {slug: parameters}) < 8e-3


def test_an_effect_without_another_law_is_refused(make_arm):
    with pytest.raises(ValueError, match="effect 'draught' has no other law; those that have are backlash"):
        suggest_other_law("draught", np.random.default_rng(0), make_arm())


# -- Wrong parameters --------------------------------------------------------------------------------------------------


def test_a_wrong_effect_is_one_clear_error_as_approved(make_arm, make_plant):
    """Lines name an effect and its parameters as JSON."""

    def refused(effect: str, parameters: str) -> object:
        return make_plant(make_arm(effects={effect: json.loads(parameters)}))

    assert_refused(Path(__file__).parent / "approved" / "wrong-effects.txt", refused)


def test_an_unknown_effect_is_told_those_that_there_are(make_arm, make_plant):
    with pytest.raises(ValueError, match="arm left: unknown effect 'gremlins'; effects are backlash, base_drift"):
        make_plant(make_arm(effects={"gremlins": {}}))
