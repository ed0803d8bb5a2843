"""Effects in motion: named by what simulated arms have, with their sizes; none where there are none."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from cellapp.estimation.motion.effects import _Search, effects_in_motion
from cellapp.estimation.motion.fit import solve
from cellapp.estimation.motion.identify import RecordedArm, identify_from_motion, motion_problem
from cellapp.estimation.motion.joint_path import joint_path, play
from cellapp.estimation.motion.steps import State, Step, effects_of, vibration
from cellapp.estimation.motion.terms import JointTerm, Law, Masses, of_all_joints, torques_in_motion
from cellapp.robot.effects import EFFECTS, EffectContext, MeasurementConditions
from cellapp.robot.effects.effect import displacement
from cellapp.robot.kinematics.chain import nominal_geometry
from cellapp.robot.kinematics.statics import Bodies
from tests.estimation.motion.simulated import UR10, Arm, corners, lost_motion, record, sweep, true_arm

NOMINAL = nominal_geometry(UR10, np.zeros(3))
BODIES = Bodies(
    masses=np.array([7.8, 12.9, 3.9, 2.0, 2.0, 0.2]),
    centers=np.array([[0, -0.03, 0], [0.3, 0, 0.16], [0.28, 0, 0.05], [0, 0, 0.02], [0, 0, 0.02], [0, 0, -0.03]]),
    payload_mass=1.0,
    payload_center=np.array([0.0, 0.0, 0.05]),
)

MASSES = np.array([*BODIES.masses, BODIES.payload_mass])


def centers(arm, q):
    """Centres of all masses (7, n, 3) of the nominal chain on the base of ``arm``."""

    def pose(own, q):
        origin = own.points(q)
        axes = [replace(own, tool=axis).points(q) - origin for axis in np.eye(3)]
        T = np.zeros((len(q), 4, 4))
        T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = np.stack(axes, axis=2), origin, 1.0
        return T

    T = np.broadcast_to(arm.base, (len(q), 4, 4))
    found = []
    for joint, (theta, d, a, alpha) in enumerate(UR10):
        own = replace(arm, rows=np.array([[theta, d, a, alpha, 0.0]]), base=np.eye(4), tool=np.zeros(3))
        T = T @ pose(own, q[:, joint : joint + 1])
        found.append(T[:, :3, :3] @ BODIES.centers[joint] + T[:, :3, 3])
    return np.stack([*found, T[:, :3, :3] @ BODIES.payload_center + T[:, :3, 3]])


def torques_of(arm, motion, t, up_M):
    """Torques (n, 6) [Nm] of the weight and of the accelerations of all masses, by virtual work."""
    h = 1e-3
    before, now, after = (centers(arm, motion.at(t + step)) for step in (-h, 0.0, h))
    force = MASSES[:, None, None] * (-9.80665 * up_M - (after - 2 * now + before) / h**2)
    q, by = motion.at(t), 1e-5 * np.eye(6)
    moved = ((centers(arm, q + one) - centers(arm, q - one)) / 2e-5 for one in by)
    return np.column_stack([np.sum(force * its, axis=(0, 2)) for its in moved])


@dataclass(frozen=True)
class Elastic(Arm):
    """An arm whose joints twist by ``compliance`` (6,) [rad/Nm] under the load of its masses, up being z; by twice as
    much up to the torque ``knee`` [Nm]."""

    compliance: np.ndarray = field(default_factory=lambda: np.zeros(6))
    knee: float = 0.0

    def twist(self, motion, when):
        torque = torques_of(self, motion, when, np.array([0.0, 0.0, 1.0]))
        return self.compliance * (torque + np.clip(torque, -self.knee, self.knee))


def found_in(*recordings, **options):
    discovery = effects_in_motion(RecordedArm(NOMINAL, recordings, tool_unknown=True, **options))
    return discovery, {effect.slug: effect for effect in discovery.effects}


def test_dense_lines_play_and_lag_are_named_with_their_sizes():
    rng = np.random.default_rng(1)
    amplitude, phase = np.array([30e-6, 25e-6, 35e-6, 0, 0, 0, 0]), rng.uniform(0.0, 6.0, 7)
    arm = replace(
        true_arm(rng, half_play=[20e-6] * 6),
        cycles=40.0,
        amplitude=amplitude,
        phase=phase,
        lag_s=np.array([0.0, 0.0, 0.0, 0.0, 0.002, 0.0, 0.0]),
    )
    discovery, found = found_in(record(rng, arm, sweep(rng, 6), seconds=300.0, white=15e-6, slow=20e-6))
    assert set(found) == {"backlash", "transmission_error", "tracking_lag"}
    of_lines = found["transmission_error"]
    lines = dict(zip(of_lines.names, of_lines.values, strict=True))
    errors = dict(zip(of_lines.names, of_lines.standard_errors, strict=True))
    assert set(lines) == {f"{wave}40q{joint}" for wave in ("cos", "sin") for joint in (1, 2, 3)}
    for joint in range(3):
        measured = complex(lines[f"sin40q{joint + 1}"], lines[f"cos40q{joint + 1}"])
        true = amplitude[joint] * np.exp(1j * phase[joint])
        error = np.hypot(errors[f"sin40q{joint + 1}"], errors[f"cos40q{joint + 1}"])
        assert error < 0.08 * abs(true)
        assert abs(measured - true) < 3.5 * error
    assert {1, 2, 3} <= set(found["backlash"].joints)
    assert found["backlash"].values[:3] == pytest.approx(20e-6, abs=5e-6)
    assert 5 in found["tracking_lag"].joints
    lags = dict(zip(found["tracking_lag"].names, found["tracking_lag"].values.tolist(), strict=True))
    assert lags["lag5"] == pytest.approx(0.002 * 5 / 6, rel=0.2)
    assert "at rest" in found["tracking_lag"].only_motion
    assert "aliased" in found["transmission_error"].only_motion
    assert not found["tracking_lag"].at_rest
    assert {term.slug for term in discovery.terms} == {"backlash", "transmission_error"}
    clock = discovery.fit.clocks["sweep"]
    assert clock.offset_standard_error_s < 1e-4
    assert clock.offset_s == pytest.approx(0.0178 + 0.002 / 6, abs=4 * clock.offset_standard_error_s)
    assert discovery.heldout_after_mm < discovery.heldout_before_mm


@pytest.mark.slow
def test_time_constants_and_vibration_are_named_with_their_sizes_and_stay_out_of_commands():
    rng = np.random.default_rng(7)
    late = np.array([0.018, 0.015, 0.022, 0.025, 0.027, 0.012, 0.0])
    arm = replace(true_arm(rng), time_constant=late, springs={0: (9.0, 0.04)})
    discovery, found = found_in(record(rng, arm, corners(rng, 6, 60.0), seconds=60.0, point_hz=50.0, slow=10e-6))
    assert set(found) == {"time_constant", "vibration", "inertia"}
    assert found["time_constant"].values == pytest.approx(late[:6], abs=1e-3)
    gain, hz, damping = found["vibration"].values
    assert (gain, hz, damping) == pytest.approx((1.0 / (2.0 * np.pi * 9.0) ** 2, 9.0, 0.04), rel=0.1)
    assert found["inertia"].joints == found["vibration"].joints == (1,)
    assert all(effect.only_motion and not effect.at_rest for effect in found.values())
    assert discovery.terms == ()
    assert discovery.fit.clocks["sweep"].offset_s == pytest.approx(0.0178, abs=1e-3)
    assert discovery.heldout_after_mm < 0.2 * discovery.heldout_before_mm


def test_of_two_vibrations_the_one_that_chance_explains_goes_and_the_other_stays():
    rng = np.random.default_rng(8)
    arm = replace(true_arm(rng), springs={0: (9.0, 0.04)})
    recording = record(rng, arm, corners(rng, 6, 20.0), seconds=20.0, slow=0.0)
    problem, rows = motion_problem(RecordedArm(NOMINAL, (recording,), tool_unknown=True), lambda words: None)
    by_chance, true = vibration(2, (1e-4, 20.0, 0.05)), vibration(0, (1.0 / (2.0 * np.pi * 9.0) ** 2, 9.0, 0.04))
    problem = problem.without_terms().with_terms((*by_chance, *true))
    solution = solve(problem, rows)
    search = _Search(problem, rows, lambda words: None)
    steps = [Step(Law.VIBRATION, terms, 500.0, -200.0, 1.0, 1.0) for terms in (by_chance, true)]
    _, kept = search._without_chance(State(problem, solution, 1.0), steps)
    assert kept == steps[1:]


def test_play_is_no_dry_friction_where_no_joint_winds_up():
    rng = np.random.default_rng(9)
    arm = true_arm(rng, half_play=[120e-6] * 6)
    motion = sweep(rng, 6, base_hz=0.02, harmonics=10)
    recording = record(rng, arm, motion, seconds=60.0, point_hz=40.0, slow=0.0)
    recorded = RecordedArm(NOMINAL, (recording,), tool_unknown=True, bodies=BODIES, up_M=np.array([0.0, 0.0, 1.0]))
    problem, rows = motion_problem(recorded, lambda words: None)
    steps = [Step(law, of_all_joints(law, 6), 100.0, -50.0, 1.0, 1.0) for law in (Law.PLAY, Law.WINDUP)]
    problem = problem.without_terms().with_terms(tuple(term for step in steps for term in step.terms))
    (effect, terms), *others = effects_of(State(problem, solve(problem, rows), 1.0), steps)
    assert (effect.slug, effect.form, others) == ("backlash", "constant", [])
    assert terms == steps[0].terms
    assert effect.values == pytest.approx([120e-6] * 6, rel=0.15)
    alone = problem.without_terms().with_terms(steps[0].terms)
    state = State(alone, solve(alone, rows), 1.0)
    for rival, share in ((-50.0, 0.5), (-47.0, 0.95), (np.inf, 1.0)):  # wind-up that would explain as much, or less
        ((effect, _),) = effects_of(state, [replace(steps[0], rival=rival)])
        assert effect.posterior == pytest.approx(share, abs=0.01)


class OffCentre(Arm):
    """An arm whose discs are off their axes: all joints turn by 90 urad more at a quarter turn."""

    def points(self, q):
        return super().points(q + 90e-6 * np.sin(q))


def test_two_cycles_beside_much_more_of_one_are_of_the_same_disc():
    rng = np.random.default_rng(10)
    plain = true_arm(rng)
    amplitude = np.array([15e-6, 60e-6, 0, 0, 0, 0, 0])
    arm = OffCentre(plain.rows, plain.tool, plain.base, plain.half_play, cycles=2.0, amplitude=amplitude)
    recording = record(rng, arm, sweep(rng, 6, reach=2.5), seconds=100.0, point_hz=40.0, white=5e-6, slow=0.0)
    problem, rows = motion_problem(RecordedArm(NOMINAL, (recording,), tool_unknown=True), lambda words: None)
    one_cycle = of_all_joints(Law.ONE_CYCLE, 6)
    lines = tuple(JointTerm(Law.LINE, joint, 2, sine) for joint in range(2) for sine in (False, True))
    steps = [Step(law, its, 100.0, -50.0, 1.0, 1.0) for law, its in ((Law.LINE, lines), (Law.ONE_CYCLE, one_cycle))]
    problem = problem.without_terms().with_terms((*lines, *one_cycle))
    (gear, of_gear), (disc, of_disc) = effects_of(State(problem, solve(problem, rows), 1.0), steps)
    assert (gear.slug, gear.joints, gear.form) == ("transmission_error", (2,), "lines")
    assert of_gear == lines[2:]
    assert (disc.slug, disc.form, disc.at_rest) == ("encoder_eccentricity", "tilted", True)
    assert set(of_disc) >= set(lines[:2])
    value, q = dict(zip(disc.names, disc.values.tolist(), strict=True)), rng.uniform(-1.0, 1.0, (20, 6))
    context = EffectContext(q, MeasurementConditions(), NOMINAL, BODIES, np.array([0.0, 0.0, 1.0]))
    turned = displacement([disc.term()], EFFECTS, context).joints[:, 0]
    waves = [value[f"{w}{n}q1"] * of(n * q[:, 0]) for n in (1, 2) for w, of in (("cos", np.cos), ("sin", np.sin))]
    np.testing.assert_allclose(turned, sum(waves), rtol=1e-9)
    assert np.hypot(value["cos2q1"], value["sin2q1"]) == pytest.approx(15e-6, abs=5e-6)


def recordings_of_springs(rng, *, count=4, base_hz=0.0625, point_hz=100.0, knee=0.0):
    """Recordings of an arm with springs in joints 2 and 3, a period of a base frequency each."""
    rigid = true_arm(rng)
    base = np.eye(4)
    base[:3, 3] = rigid.base[:3, 3]
    springs = np.array([0, 17e-6, 29e-6, 0, 0, 0])
    arm = Elastic(rigid.rows, rigid.tool, base, rigid.half_play, compliance=springs, knee=knee)
    motions = [sweep(rng, 6, base_hz=base_hz, harmonics=3) for _ in range(count)]
    return [
        record(rng, arm, motion, seconds=1.0 / base_hz, point_hz=point_hz, slow=0.0, name=f"sweep-{n}")
        for n, motion in enumerate(motions)
    ]


def test_elastic_joints_are_named_with_their_size_and_no_point_is_a_gross_error():
    recordings = recordings_of_springs(np.random.default_rng(6))
    rigid_fit = identify_from_motion(RecordedArm(NOMINAL, recordings, tool_unknown=True))
    assert sum(one.gross for one in rigid_fit.recordings.values()) < 5
    discovery, found = found_in(*recordings, bodies=BODIES, up_M=np.array([0.0, 0.0, 1.0]))
    assert set(found) == {"joint_compliance"}
    spring = found["joint_compliance"]
    size = dict(zip(spring.joints, zip(spring.values, spring.standard_errors), strict=True))
    assert size.pop(2)[0] == pytest.approx(17e-6, rel=0.02)
    assert size.pop(3)[0] == pytest.approx(29e-6, rel=0.02)
    assert all(value < 4.0 * error for value, error in size.values())  # other joints have what predicts best: little
    assert discovery.heldout_after_mm < 0.05 * discovery.heldout_before_mm


def test_springs_that_are_softer_below_a_knee_are_named_with_it():
    knee = 30.0
    recordings = recordings_of_springs(np.random.default_rng(9), count=3, base_hz=0.02, point_hz=20.0, knee=knee)
    discovery, found = found_in(*recordings, bodies=BODIES, up_M=np.array([0.0, 0.0, 1.0]))
    assert set(found) == {"joint_compliance"}
    spring = found["joint_compliance"]
    assert spring.form in ("two_slope", "three_slope")
    value, constants = dict(zip(spring.names, spring.values, strict=True)), spring.constants
    for joint, stiff in ((2, 17e-6), (3, 29e-6)):
        for torque in (10.0, 60.0):
            twist = value[f"compliance{joint}"] * torque
            for part, where in (("soft", "knee"), ("middle", "second_knee")):
                twist += value.get(f"{part}{joint}", 0.0) * min(torque, constants.get(f"{where}{joint}", 0.0))
            assert twist == pytest.approx(stiff * (torque + min(torque, knee)), rel=0.1)
    assert discovery.heldout_after_mm < 0.2 * discovery.heldout_before_mm


@pytest.mark.parametrize("seed", [2, 3])
def test_nothing_is_found_where_nothing_is(seed):
    rng = np.random.default_rng(seed)
    motion = corners(rng, 6, 120.0) if seed == 3 else sweep(rng, 6)  # corners excite vibration where there is any
    discovery, _ = found_in(record(rng, true_arm(rng), motion), bodies=BODIES, up_M=np.array([0.0, 0.0, 1.0]))
    assert discovery.effects == ()


def test_play_has_history():
    rng = np.random.default_rng(4)
    q = np.cumsum(rng.normal(0.0, 1e-4, (4000, 3)), axis=0)
    gap = np.array([1e-4, 5e-4, 0.0])
    np.testing.assert_allclose(play(q, gap), lost_motion(q, gap), rtol=0.0, atol=1e-15)


def test_torques_in_motion_are_those_of_virtual_work():
    rng = np.random.default_rng(5)
    motion = sweep(rng, 6, base_hz=0.2, harmonics=3, speed=1.5)
    arm = true_arm(rng)
    path = joint_path(record(rng, arm, motion, seconds=10.0, joint_hz=500.0).joints)
    geometry, up_M = NOMINAL.with_T_M_B(arm.base), np.array([0.3, -0.2, np.sqrt(1 - 0.13)])
    t = np.linspace(1.0, 9.0, 15)
    computed = torques_in_motion(path, t, Masses(geometry, BODIES, up_M))
    np.testing.assert_allclose(computed, torques_of(arm, motion, t, up_M), atol=0.1)
