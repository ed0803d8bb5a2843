"""Effects in motion: named by what simulated arms have, with their sizes; none where there are none."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.commands.discover.view import view
from cellapp.estimation.discovery.discover import discover_cell
from cellapp.estimation.discovery.records import ArmDiscoveryResult, DiscoverResult
from cellapp.estimation.motion.calibrate import SearchWithRecordings, calibrate_with_motion
from cellapp.estimation.motion.effects import effects_in_motion
from cellapp.estimation.motion.fit import solve
from cellapp.estimation.motion.identify import RecordedArm, identify_from_motion, motion_problem
from cellapp.estimation.motion.laws import JointLaw, joint_path, line, of_all_joints, state_in_motion
from cellapp.estimation.motion.search_state import LawStep, State, effects_of
from cellapp.estimation.motion.streams import JointStream
from cellapp.ground.profile import DiscoverySettings
from cellapp.ground.threads import one_blas_thread
from cellapp.robot.effects import EFFECTS, EffectContext, Linear, MeasurementConditions, motion_laws, own_law
from cellapp.robot.effects.effect import displacement
from cellapp.robot.kinematics.chain import nominal_geometry, smr_positions
from cellapp.robot.kinematics.statics import Bodies
from tests.arms import UR10
from tests.estimation.motion.simulated import Arm, corners, record, sweep, true_arm
from tests.interfaces.plugins.installed import EXAMPLE, add_distribution, installed
from tests.robot.effects.cell import context_of
from tests.series import readings_at
from tests.sure import sure

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
    return discovery, {effect.found.effect: effect.found for effect in discovery.effects}


def values_of(effect):
    return np.array([parameter.value for parameter in effect.parameters.values()])


def test_time_constants_and_vibration_are_named_with_their_sizes_and_stay_out_of_commands():
    rng = np.random.default_rng(7)
    late = np.array([0.018, 0.015, 0.022, 0.025, 0.027, 0.012, 0.0])
    arm = replace(true_arm(rng), time_constant=late, springs={0: (9.0, 0.04)})
    discovery, found = found_in(record(rng, arm, corners(rng, 6, 60.0), seconds=60.0, point_hz=50.0, slow=10e-6))
    assert set(found) == {"time_constant", "vibration", "inertia"}
    assert values_of(found["time_constant"]) == pytest.approx(late[:6], abs=1e-3)
    gain, hz, damping = values_of(found["vibration"])
    assert (gain, hz, damping) == pytest.approx((1.0 / (2.0 * np.pi * 9.0) ** 2, 9.0, 0.04), rel=0.1)
    assert found["inertia"].joints == found["vibration"].joints == (1,)
    assert all(effect.only_motion and not effect.at_rest for effect in found.values())
    assert discovery.terms == ()
    assert discovery.fit.clocks["sweep"].offset_s == pytest.approx(0.0178, abs=1e-3)
    assert discovery.heldout_after_mm < 0.2 * discovery.heldout_before_mm


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
    problem = motion_problem(RecordedArm(NOMINAL, (recording,), tool_unknown=True), lambda words: None)
    one_cycle = of_all_joints(JointLaw.ONE_CYCLE, 6)
    lines = (*line(0, 2), *line(1, 2))
    steps = [
        LawStep(law, its, 100.0, -50.0, 1.0, 1.0)
        for law, its in ((JointLaw.LINE, lines), (JointLaw.ONE_CYCLE, one_cycle))
    ]
    problem = problem.with_terms((*lines, *one_cycle))
    gear, disc = effects_of(State(problem, solve(problem), 1.0, tuple(steps)))
    assert disc.found.law is not None
    assert (gear.found.effect, gear.found.joints, sure(gear.found.law).name) == ("transmission_error", (2,), "lines")
    assert gear.terms == lines[2:]
    assert (disc.found.effect, disc.found.law.name, disc.found.at_rest) == ("encoder_eccentricity", "tilted", True)
    assert set(disc.terms) >= set(lines[:2])
    value, q = {name: one.value for name, one in disc.found.parameters.items()}, rng.uniform(-1.0, 1.0, (20, 6))
    context = EffectContext(q, MeasurementConditions(), NOMINAL, BODIES, np.array([0.0, 0.0, 1.0]))
    angular = displacement([disc.term()], EFFECTS, context).joints[:, 0]
    waves = [value[f"{w}{n}q1"] * of(n * q[:, 0]) for n in (1, 2) for w, of in (("cos", np.cos), ("sin", np.sin))]
    np.testing.assert_allclose(angular, sum(waves), rtol=1e-9)
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


@pytest.mark.slow
def test_elastic_joints_are_named_with_their_size_and_no_point_is_a_gross_error():
    recordings = recordings_of_springs(np.random.default_rng(6))
    rigid_fit = identify_from_motion(RecordedArm(NOMINAL, recordings, tool_unknown=True))
    assert sum(one.result.gross for one in rigid_fit.recordings.values()) < 5
    discovery, found = found_in(*recordings, bodies=BODIES, up_M=np.array([0.0, 0.0, 1.0]))
    assert set(found) == {"joint_compliance"}
    spring = found["joint_compliance"]
    size = dict(zip(spring.joints, ((p.value, p.standard_error) for p in spring.parameters.values()), strict=True))
    assert size.pop(2)[0] == pytest.approx(17e-6, rel=0.02)
    assert size.pop(3)[0] == pytest.approx(29e-6, rel=0.02)
    assert all(value < 4.0 * error for value, error in size.values())  # other joints have what predicts best: little
    assert discovery.heldout_after_mm < 0.05 * discovery.heldout_before_mm


@pytest.mark.slow
def test_springs_that_are_softer_below_a_knee_are_named_with_it():
    knee = 30.0
    recordings = recordings_of_springs(np.random.default_rng(9), count=3, base_hz=0.02, point_hz=20.0, knee=knee)
    discovery, found = found_in(*recordings, bodies=BODIES, up_M=np.array([0.0, 0.0, 1.0]))
    assert set(found) == {"joint_compliance"}
    spring = found["joint_compliance"]
    assert spring.law.name in ("two_slope", "three_slope")
    value, constants = {name: one.value for name, one in spring.parameters.items()}, spring.law.constants
    for joint, stiff in ((2, 17e-6), (3, 29e-6)):
        for torque in (10.0, 60.0):
            twist = value[f"compliance{joint}"] * torque
            for part, where in (("soft", "knee"), ("middle", "second_knee")):
                twist += value.get(f"{part}{joint}", 0.0) * min(torque, constants.get(f"{where}{joint}", 0.0))
            assert twist == pytest.approx(stiff * (torque + min(torque, knee)), rel=0.1)
    assert discovery.heldout_after_mm < 0.2 * discovery.heldout_before_mm


@pytest.mark.parametrize("seed", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_nothing_is_found_where_nothing_is(seed):
    rng = np.random.default_rng(seed)
    motion = corners(rng, 6, 120.0) if seed == 3 else sweep(rng, 6)  # corners excite vibration where there is any
    discovery, _ = found_in(record(rng, true_arm(rng), motion), bodies=BODIES, up_M=np.array([0.0, 0.0, 1.0]))
    assert discovery.effects == ()


# -- Lost motion that joints take up gradually: its history along a path, its reach from a fit, and the same at rest ---


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


# -- Discovery of an arm that was recorded in motion: its model where it predicts better, and its words ----------------

PROFILE = load_profile(Path(__file__).parents[3] / "profiles" / "ur10-real.yaml")
QUICK = PROFILE.model_copy(
    update={"discovery": DiscoverySettings(null_simulations=20, folds=2, false_alarm=0.05, network="never")}
)
"""With a short search of the samples: what recordings show is searched as ever."""


@pytest.mark.slow
def test_dense_lines_and_play_enter_the_model_and_a_lag_does_not():
    rng = np.random.default_rng(1)
    arm = replace(
        true_arm(rng, half_play=[40e-6] * 6),
        cycles=40.0,
        amplitude=np.array([60e-6, 50e-6, 0, 0, 0, 0, 0]),
        phase=rng.uniform(0.0, 6.0, 7),
        lag_s=np.array([0.0, 0.0, 0.0, 0.0, 0.003, 0.0, 0.0]),
    )
    motion = sweep(rng, 6)
    recordings = {"left": (record(rng, arm, motion, seconds=100.0, point_hz=50.0, slow=10e-6),)}
    none = readings_at(np.zeros((0, 6)), np.zeros((0, 3)))
    with one_blas_thread():
        calibrated, of_arms = calibrate_with_motion(QUICK, {"left": none}, recordings)
        model = calibrated.model
        samples = of_arms["left"]
        search = SearchWithRecordings(model.arms, {"left": none}, recordings)
        found = discover_cell(QUICK, model, {"left": samples}, search_arm=search)
    discovery = found.arms["left"]
    assert discovery.result.motion is not None
    assert discovery.result.motion.used
    assert {term.slug for term in discovery.terms} == {"backlash", "transmission_error"}
    assert {one.effect for one in discovery.result.motion.effects} == {"backlash", "transmission_error", "tracking_lag"}
    model_arm = found.model.arms["left"]
    assert sure(model_arm.covariance).shape == (len(model_arm.identified),) * 2
    q, side = motion.at(np.linspace(0.0, 50.0, 200)), np.sign(motion.speed(np.linspace(0.0, 50.0, 200)))
    true = arm.points(q - arm.half_play * side + arm.amplitude[:6] * np.sin(40.0 * q + arm.phase[:6]))
    with_effects = np.linalg.norm(model_arm.predict(q, MeasurementConditions(approach=side)) - true, axis=1)
    without = np.linalg.norm(smr_positions(model.arms["left"].geometry, q) - true, axis=1)
    assert np.sqrt(np.mean(with_effects**2)) < 0.5 * np.sqrt(np.mean(without**2))
    assert ArmDiscoveryResult.model_validate_json(discovery.result.model_dump_json(by_alias=True)) is not None
    text = str(view(DiscoverResult(arms={"left": discovery.result})))
    assert "a delay moves nothing at rest" in text
    assert "stays out of commands" in text


# -- A law of one's own in motion --------------------------------------------------------------------------------------


GREASE = "grease_drag"
TRUE = np.array([120e-6, 160e-6, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture
def plugin(tmp_path):
    """The effect of the handbook, installed by its entry point."""
    module = (EXAMPLE / "cellapp_example" / "grease_drag.py").read_text("utf-8")
    entries = {"cellapp.robot.effects": {GREASE: "grease:grease_drag"}}
    with installed(add_distribution(tmp_path, "grease", entries, {"grease.py": module})):
        yield


def recording(seed, **changes):
    rng = np.random.default_rng(seed)
    return record(
        rng, replace(true_arm(rng), **changes), sweep(rng, 6, speed=0.8), seconds=200.0, point_hz=50.0, slow=20e-6
    )


def test_it_is_found_in_recordings_with_its_size(plugin):
    discovery, found = found_in(recording(11, drag=TRUE))
    assert set(found) == {GREASE}
    drag = found[GREASE]
    assert {1, 2} <= set(drag.joints)
    assert list(drag.parameters)[:2] == ["drag1", "drag2"]
    assert values_of(drag)[:2] == pytest.approx(TRUE[:2], rel=0.1)
    assert not drag.at_rest
    assert "speeds" in drag.only_motion
    assert discovery.heldout_after_mm < discovery.heldout_before_mm
    assert discovery.terms == ()


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_own(plugin):
    assert found_in(recording(12))[0].effects == ()


def test_readings_at_rest_cannot_show_it(plugin):
    assert len(motion_laws(EFFECTS.values())) == 3
    assert "no speeds" in EFFECTS[GREASE].missing_data(context_of())


def test_a_law_of_speeds_takes_what_motion_has():
    def warm(qd, air_c, drag):
        return -drag * qd * air_c[:, None]

    with pytest.raises(ValueError, match=r"law warm: a law of speeds acts on joints and takes no other quantities"):
        own_law("warm", drag=Linear("s", 1e-2))(warm)


def test_accelerations_are_those_of_the_path():
    t = np.arange(0.0, 4.0, 0.008)
    q = np.stack([0.5 * np.sin(2.0 * t), 0.2 * np.cos(3.0 * t)], axis=1)
    path = joint_path(JointStream(time_s=t, q=q))
    inside = np.linspace(0.5, 3.5, 40)
    found = state_in_motion(path, inside, None).quantity("qdd")
    assert found == pytest.approx(
        np.stack([-2.0 * np.sin(2.0 * inside), -1.8 * np.cos(3.0 * inside)], axis=1), abs=0.02
    )
