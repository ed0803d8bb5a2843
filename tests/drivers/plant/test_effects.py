"""Hidden effects against their definitions, and their parameters."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.plant import ONLY_MOVING, OUTSIDE, REALISTIC, suggest
from drivers.plant.effect import Effect
from drivers.plant.effects import FACTORIES, build
from drivers.plant.mechanism import Deflection
from drivers.plant.transforms import rigid, transform_points

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


def test_after_long_moves_the_batch_agrees_with_the_history(make_arm, make_plant):
    arm = make_arm(effects={"backlash": {"play": [1e-3] * 6}, "joint_compliance": {"stiffness": [5e4] * 6}})
    plant = make_plant(arm)
    before = plant.q("left")
    for q in np.random.default_rng(1).uniform(-2, 2, (5, 6)):
        _go(plant, q)
        found = plant.smr_positions("left", q[None], approach=(q - before)[None])[0]
        assert np.abs(plant.targets()[0].p_M - found).max() < 1e-11
        before = q
    centred = plant.smr_positions("left", before[None])
    assert np.array_equal(centred, plant.smr_positions("left", before[None], approach=np.zeros((1, 6))))
    assert np.abs(centred - plant.smr_positions("left", before[None], approach=np.ones((1, 6)))).max() > 1e-5


def test_an_interrupted_motion_counts_in_the_history(make_arm, make_plant):
    arm = make_arm(effects={"backlash": {"play": [1e-2] * 6}})
    plant, ideal = make_plant(arm), make_plant()
    plant.start_move("left", np.full(6, 1.0), **FAST)
    plant.advance(0.4)
    plant.stop("left")
    plant.advance(2.0)
    stopped = plant.q("left")
    assert (stopped > 0.05).all()
    assert (stopped < 0.95).all()
    assert np.abs(plant.targets()[0].p_M - ideal.smr_positions("left", stopped[None] - 5e-3)[0]).max() < 1e-12
    _go(plant, stopped - 4e-3)  # the drive turns back inside the play: the joint stays
    assert np.abs(plant.targets()[0].p_M - ideal.smr_positions("left", stopped[None] - 5e-3)[0]).max() < 1e-12


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"gremlins": {}}, "arm left: unknown effect 'gremlins'; effects are backlash, base_drift"),
        ({"backlash": {"plays": [0] * 6}}, "arm left, effect backlash: unknown parameter 'plays'; its .* are play"),
        ({"backlash": {}}, "arm left, effect backlash: parameter 'play' is missing"),
        ({"backlash": [1]}, "arm left, effect backlash: expected its parameters by name"),
        ({"backlash": {"play": [0] * 5}}, "play must be a list of 6 numbers"),
        ({"backlash": {"play": 1e-4}}, "play must be a list of 6 numbers, not 0.0001"),
        ({"backlash": {"play": ["1 deg"] * 6}}, "play must hold numbers in SI units, not '1 deg'"),
        ({"backlash": {"play": [float("nan")] * 6}}, "play must hold numbers in SI units, not nan"),
        ({"backlash": {"play": [True] * 6}}, "play must hold numbers in SI units, not True"),
        ({"backlash": {"play": [-1e-4] * 6}}, "play must be at least 0, not -0.0001"),
        ({"joint_compliance": {"stiffness": [0] * 6}}, "stiffness must be greater than 0, not 0"),
    ],
)
def test_a_wrong_effect_is_one_clear_error(make_arm, make_plant, effects, message):
    with pytest.raises(ValueError, match=message):
        make_plant(make_arm(effects=effects))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joints": [0]}, "joints must be a list of different joint numbers from 1 to 6, not \\[0\\]"),
        ({"joints": [7]}, "joint numbers from 1 to 6"),
        ({"joints": [2, 2]}, "different joint numbers"),
        ({"joints": []}, "different joint numbers"),
        ({"joints": [1.5]}, "different joint numbers"),
        ({"joints": [1, 2]}, "eccentricity must be a list of 2 numbers"),
        ({"radius": [0.0]}, "radius must be greater than 0"),
        ({"radius": [1e-6]}, "eccentricity must be smaller than radius"),
    ],
)
def test_a_wrong_disc_is_one_clear_error(make_arm, make_plant, changes, message):
    disc = {"joints": [2], "eccentricity": [2e-6], "radius": [0.025], "phase": [0.0]} | changes
    with pytest.raises(ValueError, match=f"arm left, effect encoder_eccentricity: .*{message}"):
        make_plant(make_arm(effects={"encoder_eccentricity": disc}))


@dataclass
class _Twist(Effect):
    """A constant twist of one part."""

    part: str
    value: np.ndarray

    def offset(self, situation, memory):
        return Deflection(**{self.part: self.value})


def _with_twist(monkeypatch, part, value):
    monkeypatch.setitem(FACTORIES, "twist", lambda parameters: _Twist(part, value))
    return {"twist": {}}


def test_a_twist_of_the_base_moves_the_whole_arm(monkeypatch, make_arm, make_plant):
    twist = np.array([1e-3, 2e-3, -1e-3, 1e-3, -2e-3, 5e-4])
    q = np.random.default_rng(0).uniform(-3, 3, (4, 6))
    ideal = make_plant()
    pose = ideal.true_T_M_B("left")
    p_B = transform_points(np.linalg.inv(pose), ideal.smr_positions("left", q))
    effects = _with_twist(monkeypatch, "base", np.tile(twist, (4, 1)))
    found = make_plant(make_arm(effects=effects)).smr_positions("left", q)
    assert np.abs(found - transform_points(pose, transform_points(rigid(twist), p_B))).max() < 1e-13


def test_a_twist_of_a_link_about_its_z_is_the_next_joint_turned(monkeypatch, make_arm, make_plant):
    q = np.random.default_rng(0).uniform(-3, 3, (4, 6))
    for link in range(5):
        twists = np.zeros((4, 6, 6))
        twists[:, link, 5] = 2e-3
        effects = _with_twist(monkeypatch, "links", twists)
        turned = q.copy()
        turned[:, link + 1] += 2e-3
        found = make_plant(make_arm(effects=effects)).smr_positions("left", q)
        assert np.abs(found - make_plant().smr_positions("left", turned)).max() < 1e-13


def test_a_shift_of_the_tool_or_of_the_last_link_is_another_smr_offset(monkeypatch, make_arm, make_plant):
    q = np.random.default_rng(0).uniform(-3, 3, (4, 6))
    shift = np.array([1e-3, -2e-3, 3e-3])
    other = make_arm(smr_offset=make_arm().smr_offset + shift)
    expected = make_plant(other).smr_positions("left", q)
    tool = np.tile(np.append(shift, np.zeros(3)), (4, 1))
    last = np.zeros((4, 6, 6))
    last[:, 5] = tool
    for part, value in (("tool", tool), ("links", last)):
        effects = _with_twist(monkeypatch, part, value)
        found = make_plant(make_arm(effects=effects)).smr_positions("left", q)
        assert np.abs(found - expected).max() < 1e-13


class _Pedestal(Effect):
    """The base leans with the moments of both arms: needs loads and the other arm."""

    def bend(self, situation, posture):
        moment = posture.base_moment + situation.others["right"].base_moment
        return Deflection(base=np.concatenate([np.zeros_like(moment), moment / 1e6], axis=1))


class _Refraction(Effect):
    """All points look a little farther away."""

    def apparent_position(self, p_M, normal_M, situation):
        return p_M * (1 + 1e-5)


def test_effects_of_the_other_arm_and_of_the_beam_need_no_change_elsewhere(monkeypatch, make_arm, make_plant):
    monkeypatch.setitem(FACTORIES, "pedestal", lambda parameters: _Pedestal())
    monkeypatch.setitem(FACTORIES, "refraction", lambda parameters: _Refraction())
    right = make_arm("ur5", "right", 1.2)
    q = np.random.default_rng(0).uniform(-3, 3, (4, 6))
    plant = make_plant(make_arm(effects={"pedestal": {}}), right)
    up = plant.smr_positions("left", q, others={"right": np.tile([0, -np.pi / 2, 0, 0, 0, 0], (4, 1))})
    out = plant.smr_positions("left", q, others={"right": np.zeros((4, 6))})
    assert np.abs(up - out).max() > 1e-5
    assert np.array_equal(out, plant.smr_positions("left", q))  # the right arm stands at zero
    far = make_plant(make_arm(effects={"refraction": {}})).smr_positions("left", q)
    assert np.abs(far / make_plant().smr_positions("left", q) - (1 + 1e-5)).max() < 1e-13


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


@pytest.mark.parametrize("slug", REALISTIC + OUTSIDE)
def test_the_same_state_suggests_the_same_and_another_another(make_arm, slug):
    arm = make_arm()
    one, again, other = (suggest(slug, np.random.default_rng(seed), arm, DURATION_S) for seed in (1, 1, 2))
    assert one == again
    assert one != other


@pytest.mark.parametrize("slug", ["base_step", "target_slip"])
def test_onsets_lie_within_the_run(make_arm, slug):
    rng = np.random.default_rng(0)
    for duration_s in (600.0, 36000.0):
        onsets = [suggest(slug, rng, make_arm(), duration_s)["time"] for _ in range(50)]
        assert 0.1 * duration_s < min(onsets)
        assert max(onsets) < 0.9 * duration_s
        assert max(onsets) - min(onsets) > 0.3 * duration_s


def test_every_variant_and_sign_comes_up(make_arm):
    rng, arm = np.random.default_rng(0), make_arm()
    drives = [suggest("transmission_error", rng, arm, DURATION_S) for _ in range(60)]
    assert {drive["mode"] for drive in drives} == {"lines", "curve"}
    lines = [drive for drive in drives if drive["mode"] == "lines"]
    assert {(any(d["output_slant"]), any(d["eccentric"])) for d in lines} == {
        (True, False),
        (False, True),
        (True, True),
    }
    assert {"reach" in suggest("backlash", rng, arm, DURATION_S) for _ in range(40)} == {True, False}
    assert {"knee" in suggest("joint_compliance", rng, arm, DURATION_S) for _ in range(40)} == {True, False}
    walks = [suggest("base_drift", rng, arm, DURATION_S) for _ in range(40)]
    assert {walk["law"] for walk in walks} == {"linear", "exponential", "creep"}
    assert {np.sign(suggest("tracker_scale", rng, arm, DURATION_S)["ppm"]) for _ in range(40)} == {-1.0, 1.0}
    chosen = {tuple(suggest("encoder_eccentricity", rng, arm, DURATION_S)["joints"]) for _ in range(40)}
    assert len(chosen) > 8


def test_a_lighter_arm_has_weaker_drives(make_arm):
    heavy, light = (
        np.mean(
            [
                suggest("joint_compliance", np.random.default_rng(k), make_arm(kind), 1e4)["stiffness"][1]
                for k in range(20)
            ]
        )
        for kind in ("ur10", "ur5")
    )
    assert 0.3 * heavy < light < 0.7 * heavy
    assert 5e4 < heavy < 1.3e5


def test_parameters_are_valid_for_a_weightless_arm_of_seven_joints(seven_joints):
    rng = np.random.default_rng(0)
    for slug in REALISTIC + OUTSIDE:
        parameters = suggest(slug, rng, seven_joints, DURATION_S)
        assert len(build(seven_joints.name, seven_joints.joints, {slug: parameters})) == 1, slug


def test_a_wrong_slug_or_duration_is_one_clear_error(make_arm):
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="unknown effect 'gremlins'; effects are backlash, base_drift"):
        suggest("gremlins", rng, make_arm(), DURATION_S)
    for duration_s in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="duration_s must be a positive time, not"):
            suggest("backlash", rng, make_arm(), duration_s)
