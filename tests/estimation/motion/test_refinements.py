"""Lost motion that joints take up gradually: its history along a path, its reach from a fit, and the same at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.estimation.motion.effects import refining_terms
from cellapp.estimation.motion.fit import solve
from cellapp.estimation.motion.identify import RecordedArm, motion_problem
from cellapp.estimation.motion.joint_path import Fading, joint_path
from cellapp.estimation.motion.streams import JointStream
from cellapp.estimation.motion.terms import JointLaws, JointTerm, Law, Masses, state_at_rest, state_in_motion
from cellapp.robot.effects import EFFECTS, EffectContext, EffectTerm, MeasurementConditions
from cellapp.robot.effects.effect import displacement, term_from_json, term_to_json
from cellapp.robot.kinematics.chain import nominal_geometry
from cellapp.robot.kinematics.statics import Bodies
from tests.estimation.motion.simulated import UR10, gradual, record, sweep, true_arm

NOMINAL = nominal_geometry(UR10, np.zeros(3))
REACH = 0.15


def path_of(rng):
    motion, t = sweep(rng, 6, base_hz=0.1, harmonics=3), np.arange(0.0, 30.0, 0.008)
    return motion, joint_path(JointStream(time_s=t, q=motion.at(t), qd=motion.speed(t)))


def test_what_is_kept_is_that_of_plays_in_parallel():
    motion, path = path_of(np.random.default_rng(1))
    t = np.arange(0.5, 29.5, 0.0037)
    fine = np.arange(0.0, 29.5, 0.001)
    q, direction = motion.at(t), path.direction_at(t)
    behind = motion.at(fine) - gradual(motion.at(fine), np.ones(6), REACH)
    truth = np.column_stack([np.interp(t, fine, column) for column in behind.T])
    for joint in range(6):
        left = path.fading_at(path.samples_at(t), q[:, joint], joint, Fading(REACH, kept=True))
        surely = np.abs(direction[:, joint]) == 1.0
        np.testing.assert_allclose((direction[:, joint] - left)[surely], truth[surely, joint], atol=0.05)


@pytest.mark.parametrize("bell", [False, True])
def test_what_begins_anew_fades_with_the_travel_since_the_turn(bell):
    motion, path = path_of(np.random.default_rng(2))
    t = np.arange(0.0, 29.9, 0.008)
    q = motion.at(t)
    for joint in range(6):
        turn, side = q[0, joint], 0.0
        left = path.fading_at(path.samples_at(t), q[:, joint], joint, Fading(REACH, kept=False, bell=bell))
        for i in range(1, len(t)):
            now = np.sign(q[i, joint] - q[i - 1, joint])
            if now != side:
                turn, side = q[i - 1, joint], now
            travel = abs(q[i, joint] - turn)
            if travel > 0.01:
                share = np.exp(-((travel / REACH) ** (2 if bell else 1)))
                assert left[i] == pytest.approx(side * share, abs=0.02)


def test_the_travel_of_a_joint_begins_anew_where_it_turns_round():
    motion, path = path_of(np.random.default_rng(5))
    t = np.arange(0.5, 29.9, 0.008)
    q, direction = motion.at(t), path.direction_at(t)
    travel = path.travel_at(t, q)
    surely, side = np.abs(direction) > 0.999, np.sign(direction)
    assert (np.sign(travel)[surely] == side[surely]).all()
    goes_on = surely[1:] & surely[:-1] & (side[1:] == side[:-1])
    np.testing.assert_allclose(np.diff(travel, axis=0)[goes_on], np.diff(q, axis=0)[goes_on], atol=1e-12)
    turned = surely & (np.abs(travel) < 2e-3)
    assert turned.sum() > 12, "each joint has turned round"


def test_a_fit_shows_the_reach_and_the_kind_of_memory():
    rng = np.random.default_rng(3)
    arm = replace(true_arm(rng, half_play=[120e-6] * 6), reach=REACH)
    recording = record(rng, arm, sweep(rng, 6, base_hz=0.02, harmonics=10), seconds=60.0, point_hz=40.0, slow=0.0)
    problem, rows = motion_problem(RecordedArm(NOMINAL, (recording,), tool_unknown=True), lambda words: None)
    terms = refining_terms(problem, solve(problem, rows, to_its_end=True), Law.PLAY)
    assert [term.joint for term in terms] == list(range(6))
    assert all(term.fading is not None and term.fading.kept for term in terms)
    for term in terms[:3]:
        assert term.fading is not None
        assert term.fading.reach == pytest.approx(REACH, rel=0.35)


@pytest.mark.parametrize(("constant", "bell"), [("reach2", False), ("bell_reach2", True)])
def test_at_rest_the_law_is_that_of_the_fit_and_survives_its_file(constant, bell):
    rng = np.random.default_rng(4)
    q, step = rng.uniform(-1.0, 1.0, (50, 6)), rng.uniform(-0.8, 0.8, (50, 6))
    step[0], step[1] = 0.0, np.nan
    approach = np.sign(np.nan_to_num(step, nan=1.0))
    law = EFFECTS["backlash"].law("gradual", {constant: REACH})
    names, values = ("half_play1", "half_play2", "fresh_half_play2"), np.array([30e-6, 80e-6, -60e-6])
    term = EffectTerm("backlash", names, values, np.zeros(3), ("rad",) * 3, law)
    term = term_from_json(term_to_json(term), EFFECTS)
    bodies = Bodies(np.ones(6), np.zeros((6, 3)), 0.0, np.zeros(3))
    conditions = MeasurementConditions(approach=approach, step=step)
    context = EffectContext(q, conditions, NOMINAL, bodies, np.array([0.0, 0.0, 1.0]))
    moved = displacement([term], EFFECTS, context).joints
    state = state_at_rest(q, approach, None, step)
    left = state.left(1, Fading(REACH, kept=not bell, bell=bell))
    assert (left[:2] == 0.0).all()
    np.testing.assert_allclose(moved[:, 0], -30e-6 * approach[:, 0], rtol=1e-12)
    np.testing.assert_allclose(moved[:, 1], -80e-6 * approach[:, 1] + 60e-6 * left, rtol=1e-12)
    assert "deg by joint 2" in law.words([1])


def test_an_arm_that_rests_after_a_gap_shows_no_side_until_it_moves():
    """Joints that came to rest out of sight may lie on the side that their position does not tell."""
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 20.0, 0.008)
    phases = np.select([t < 1.0, t < 8.0, t < 9.0, t < 15.0], [0.0, t - 1.0, 7.0, t - 2.0], 13.0)
    kept = (t < 8.5) | (t > 8.8)
    kept &= (t < 16.0) | (t > 16.5)  # what comes then rests to its end
    motion = sweep(rng, 6, base_hz=0.1, harmonics=3)
    path = joint_path(JointStream(time_s=t[kept], q=motion.at(phases[kept])))
    begun = path.begun(t[kept])
    rests = (t[kept] < 1.0) | ((t[kept] > 8.8) & (t[kept] < 9.0))
    assert not begun[rests].any()
    just_begun = (np.abs(t[kept] - 1.05) < 0.06) | (np.abs(t[kept] - 9.05) < 0.06)
    assert begun[~rests & ~just_begun].all()


def test_samples_with_their_history_have_the_points_of_the_motion_by_laws_at_rest():
    rng = np.random.default_rng(8)
    _, path = path_of(rng)
    t = np.linspace(2.0, 29.0, 400)
    masses = Masses(NOMINAL, Bodies(np.full(6, 4.0), np.zeros((6, 3)), 1.0, np.zeros(3)), np.array([0.0, 0.0, 1.0]))
    play = [(JointTerm(Law.PLAY, joint), 80e-6) for joint in range(6)]
    remembered = [(JointTerm(Law.PLAY, joint, fading=Fading(REACH, kept=True)), 60e-6) for joint in range(6)]
    elastic = [(JointTerm(law, 1), size) for law, size in ((Law.COMPLIANCE, 2e-6), (Law.WINDUP, 5e-7))]
    line = [(JointTerm(Law.LINE, 2, 40), 50e-6)]
    lag = ((JointTerm(Law.LAG, 3), 2e-3),)
    laws = JointLaws((*play, *remembered, *elastic, *line), lag, masses)
    moves = state_in_motion(path, t, masses, torques=True)
    of_motion = moves.q + sum(moves.offsets((term,), np.array([size])) for term, size in (*laws.at_rest, *lag))

    q = laws.joints_with_history(path, t)
    at_rest = state_at_rest(q, np.sign(np.rint(moves.direction)), masses, path.travel_at(t, moves.q))
    terms, sizes = (tuple(one) for one in zip(*laws.at_rest, strict=True))
    np.testing.assert_allclose(q + at_rest.offsets(terms, np.array(sizes)), of_motion, rtol=0.0, atol=1e-6)
    history = q - laws.joints_at_rest(path, t)
    assert np.sqrt(np.mean(history**2, axis=0)).min() > 5e-6, (
        "older turns and accelerations are no part of laws at rest"
    )
    plain = JointLaws((*play[1:], *line), lag, masses)
    turned = np.abs(moves.direction) == 1.0
    same = np.where(turned, plain.joints_with_history(path, t) - plain.joints_at_rest(path, t), 0.0)
    np.testing.assert_allclose(same, 0.0, atol=1e-6)
