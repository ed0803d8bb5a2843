"""Laws of another shape: each has the usual law as its limit, its own equation holds, and its draws are repeatable."""

from __future__ import annotations

import json

import numpy as np
import pytest

from drivers.plant import REALISTIC, gravity_torques, suggest, suggest_other_law
from drivers.plant.effect import Parameters
from drivers.plant.effects import FACTORIES
from drivers.plant.random_functions import RandomField, RandomPaths

STOPS, DURATION_S = 30, 9000.0
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
    time_s = np.sort(rng.uniform(0.0, DURATION_S, STOPS))
    return {
        "q": rng.uniform(-2.5, 2.5, (STOPS, 6)),
        "time_s": time_s,
        "last_step": rng.choice([-1.0, 1.0], (STOPS, 6)) * rng.uniform(0.1, 2.0, (STOPS, 6)),
        "since_rest_s": rng.uniform(1.0, 6.0, STOPS),
        "payload": rng.choice([0.5, 6.0], STOPS),
        "joints_c": 20.0 + 10.0 * (1.0 - np.exp(-time_s / 2400.0))[:, None] * rng.uniform(0.7, 1.3, 6),
        "air_c": 20.0 + rng.uniform(-1.0, 1.0, STOPS),
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


def test_play_that_is_used_up_at_once_is_ordinary_backlash(positions, situation):
    half, side = {"play": [1e-4] * 6}, np.sign(situation["last_step"])
    cold = {"law": "warm", "per_kelvin": 0.0, "reach": [1e-3] * 6}
    sharp, found = (positions({"backlash": half | more}, last_step=side) for more in ({}, cold))
    assert np.abs(found - sharp).max() < 1e-12


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
    alone = {"payload": np.zeros(STOPS)}
    found = positions({"joint_compliance": values}, **alone)
    turned = np.zeros((STOPS, 6))
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


def test_shear_adds_to_bending_in_the_direction_of_the_weight(positions):
    beam = {"links": [2], "bending": [1e9], "torsion": [1e9]}
    moved = positions({"link_bending": {"law": "shear", **beam, "shear": [1e6]}}) - positions({"link_bending": beam})
    down = moved @ np.array([0.0, 0.0, -1.0])
    assert (down > -1e-9).all()
    assert down.max() > 2e-5


def test_a_joint_shifts_and_tilts_with_the_chosen_harmonics(positions):
    """Equal at angles a third of a turn apart, where all harmonics are multiples of three."""
    values = {"joints": [1], "harmonics": [3.0, 6.0], "shares": [1.0, 0.4], "seed": 4}
    effects = (
        ("joint_axis_wobble", {"law": "harmonics", "tilt": [5e-5]}),
        ("joint_axis_runout", {"radial": [3e-5], "axial": [1e-5]}),
    )
    q = np.zeros((3, 6))
    q[:, 0] = 0.3 + 2.0 * np.pi / 3.0 * np.arange(3)
    for effect, sizes in effects:
        told = {"q": q, "last_step": None, "since_rest_s": None, "payload": None, "joints_c": None, "air_c": None,
                "time_s": None, "others": None}  # fmt: skip
        moved = positions({effect: values | sizes}, **told) - positions({}, **told)
        lengths = np.linalg.norm(moved, axis=1)
        assert lengths.max() > 1e-6
        if effect == "joint_axis_runout":  # a shift in the base frame: the same vector
            assert np.ptp(moved, axis=0).max() < 1e-12


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


def test_seven_joints_without_weight_have_other_laws_too(seven_joints):
    for slug in REALISTIC:
        for seed in range(4):
            parameters = suggest_other_law(slug, np.random.default_rng(seed), seven_joints, DURATION_S)
            FACTORIES[slug](Parameters("left", slug, parameters, 7))


@pytest.mark.parametrize(
    ("effect", "values", "message"),
    [
        ("backlash", {"law": "loose", "play": [0.0] * 6}, "law must be one of play, warm, many_plays, not 'loose'"),
        ("backlash", {"law": "warm", "play": [0.0] * 6}, "parameter 'reach' is missing; its parameters"),
        ("joint_compliance", {"law": "hardening", "stiffness": [0.0] * 6, "cubic": [1.0] * 6}, "greater than 0"),
        ("pedestal_compliance", {"law": "frame", "pivot": [0.0] * 3, "direct": [1e-6] * 3, "cross": [2e-6, 0.0, 0.0]},
         "cross must be smaller"),
        ("joint_axis_runout", {"joints": [1], "radial": [1e-5], "axial": [0.0], "harmonics": [], "shares": [],
                               "seed": 1}, "harmonics must be a list of numbers"),
        ("workspace_field", {"rms": 1e-4, "length": 0.0, "seed": 1}, "length must be greater than 0"),
    ],
)  # fmt: skip
def test_a_wrong_parameter_of_another_law_is_one_clear_error(effect, values, message):
    with pytest.raises(ValueError, match=f"arm left, effect {effect}: .*{message}"):
        FACTORIES[effect](Parameters("left", effect, values, 6))


def test_an_effect_without_another_law_is_refused(make_arm):
    with pytest.raises(ValueError, match="effect 'draught' has no other law; those that have are backlash"):
        suggest_other_law("draught", np.random.default_rng(0), make_arm())
