"""Hidden effects against their definitions, and their parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.plant.effect import Effect
from drivers.plant.effects import FACTORIES
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
