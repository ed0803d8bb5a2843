"""Geometry, lost motion and clocks from simulated recordings: known truth, faults of stamps, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.estimation.motion.fit import solve
from cellapp.estimation.motion.identify import RecordedArm, identify_from_motion, motion_problem, rms
from cellapp.estimation.motion.residuals import Stops, residuals
from cellapp.estimation.motion.streams import JointStream, PointStream, Recording
from cellapp.ground.errors import InputError, NotConverged
from cellapp.ground.progress import ignore_words
from cellapp.robot.kinematics.chain import nominal_geometry, smr_positions
from tests.arms import SEVEN, UR10
from tests.estimation.motion.simulated import record, sweep, true_arm

PLAY = np.array([30e-6, 20e-6, 25e-6, 40e-6, 40e-6, 0.0])


@pytest.fixture(scope="module")
def case():
    """An arm, its motion and a recording of two minutes."""
    rng = np.random.default_rng(11)
    arm = true_arm(rng, half_play=PLAY)
    motion = sweep(rng, 6)
    return arm, motion, record(rng, arm, motion)


def fit_of(*recordings, nominal=UR10, tool_unknown=True, **options):
    arm = RecordedArm(nominal_geometry(nominal, np.zeros(3)), recordings, tool_unknown=tool_unknown, **options)
    return identify_from_motion(arm)


def rms_mm(fit):
    return rms(np.concatenate([one.heldout_mm for one in fit.recordings.values()]))


def clock_holds(clock, offset_s, rate_ppm, errors=4.0):
    return (
        abs(clock.offset_s - offset_s) < errors * clock.offset_standard_error_s
        and abs(clock.rate_ppm - rate_ppm) < errors * clock.rate_standard_error_ppm
    )


def test_clocks_geometry_and_play_are_those_of_the_simulated_arm(case):
    arm, motion, recording = case
    fit = fit_of(recording)
    clock = fit.clocks["sweep"]
    assert fit.identification.converged
    assert not [sentence for sentence in fit.undetermined if "these motions determine" in sentence]
    assert clock_holds(clock, 0.0178, -18.0)
    assert clock.offset_standard_error_s < 1e-4
    assert clock.rate_standard_error_ppm < 3.0
    q = motion.at(np.linspace(0.0, 50.0, 40))
    misses = np.linalg.norm(smr_positions(fit.identification.geometry, q) - arm.points(q), axis=1)
    assert misses.max() < 0.1e-3
    assert np.all(np.abs(fit.half_play - PLAY) < 4.0 * fit.half_play_standard_error)
    assert fit.half_play[1] > 4.0 * fit.half_play_standard_error[1]


def test_stamps_that_jitter_about_a_regular_clock_are_replaced_by_it(case):
    arm, motion, _ = case
    rng = np.random.default_rng(8)
    recording = record(rng, arm, motion, with_speeds=False)
    time = np.maximum.accumulate(recording.joints.time_s + rng.uniform(0.0, 6e-3, len(recording.joints.time_s)))
    fit = fit_of(replace(recording, joints=JointStream(time_s=time, q=recording.joints.q)))
    clock = fit.clocks["sweep"]
    assert clock.offset_s == pytest.approx(0.0178 - 3e-3, abs=3e-4)  # stamps are 3 ms late in the mean
    assert rms_mm(fit) < 0.1


@pytest.mark.parametrize(
    "offset", [-1.7e9, *(pytest.param(offset, marks=pytest.mark.slow) for offset in (-40.0, 0.0)), 25.0]
)
def test_any_offset_between_the_clocks(case, offset):
    arm, motion, _ = case
    rng = np.random.default_rng(9)
    # beginnings apart: the points begin 20 s into the joints
    recording = record(rng, arm, motion, seconds=60.0, offset=offset, start_s=3.0)
    late = recording.points.time_s > recording.points.time_s[0] + 20.0
    points = PointStream(time_s=recording.points.time_s[late], p_M=recording.points.p_M[late])
    fit = fit_of(replace(recording, points=points))
    middle = (recording.points.time_s[0] + recording.points.time_s[-1]) / 2.0
    clock = fit.clocks["sweep"]
    at_middle = clock.offset_s + 1e-6 * clock.rate_ppm * (middle - clock.at_s)
    assert at_middle == pytest.approx(offset, abs=2e-4)


def test_steps_and_resets_of_either_clock_are_found_and_named(case):
    arm, motion, _ = case
    rng = np.random.default_rng(10)
    recording = record(rng, arm, motion)
    joint_time, point_time = recording.joints.time_s.copy(), recording.points.time_s.copy()
    joint_time[5000:] += 7.5
    point_time[9000:] -= 70.0
    fit = fit_of(
        replace(
            recording,
            joints=replace(recording.joints, time_s=joint_time),
            points=replace(recording.points, time_s=point_time),
        )
    )
    clock = fit.clocks["sweep"]
    ((_, of_joints_s),), ((_, of_points_s),) = clock.steps_of_joints, clock.steps_of_points
    assert of_joints_s == pytest.approx(7.5, abs=0.01)
    assert of_points_s == pytest.approx(-70.0, abs=0.01)
    assert len(clock.segments) == 3
    for segment in clock.segments:
        assert segment.offset_s == pytest.approx(0.0178, abs=5e-4)
    assert rms_mm(fit) < 0.1


def test_a_part_before_a_step_of_a_clock_of_which_nothing_is_learnt_leaves_the_rest_as_it_is(case):
    recording = case[2]
    time, held_out = recording.points.time_s.copy(), np.zeros(len(recording.points.time_s), dtype=bool)
    time[300:] += 70.0
    held_out[:300] = held_out[5000:6000] = True
    fit = fit_of(replace(recording, points=replace(recording.points, time_s=time, held_out=held_out)))
    clock = fit.clocks["sweep"]
    assert len(clock.segments) == 2
    assert fit.recordings["sweep"].result.held_out == 1000
    assert clock.offset_standard_error_s < 1e-3
    assert clock.offset_s == pytest.approx(0.0178, abs=5e-4)
    assert rms_mm(fit) < 0.1


def test_stops_and_recordings_in_one_fit(case):
    arm, _, recording = case
    rng = np.random.default_rng(13)
    q = rng.uniform(-1.5, 1.5, (60, 6))
    p_M = arm.points(q) + rng.normal(0.0, 20e-6, q[:, :3].shape)
    stops = Stops(q, p_M, sigma_m=None, approach=np.zeros_like(q), learnt=np.ones(60, dtype=bool))
    alone, both = fit_of(recording), fit_of(recording, stops=stops)
    assert both.stops_scatter_m == pytest.approx(20e-6, rel=0.5)
    trial = rng.uniform(-1.5, 1.5, (200, 6))
    errors = [
        np.sqrt(np.mean(np.sum((smr_positions(f.identification.geometry, trial) - arm.points(trial)) ** 2, axis=1)))
        for f in (alone, both)
    ]
    assert errors[1] < errors[0]


def test_blocks_that_the_file_holds_out_are_kept_apart(case):
    recording = case[2]
    held_out = np.zeros(len(recording.points.time_s), dtype=bool)
    held_out[3000:5000] = True
    spoilt = recording.points.p_M.copy()
    spoilt[3000:5000] += 2e-3
    fit = fit_of(replace(recording, points=replace(recording.points, p_M=spoilt, held_out=held_out)))
    one = fit.recordings["sweep"].result
    assert one.held_out == 2000
    assert one.heldout_rms_mm == pytest.approx(2.0 * np.sqrt(3.0), rel=0.05)  # nothing of them was learnt
    assert one.scatter_mm < 60e-3


def test_what_little_excitation_leaves_open_is_said(case):
    arm, motion, _ = case
    rng = np.random.default_rng(15)
    still = replace(motion, sine=motion.sine * [1, 1, 1, 0, 0, 0], cosine=motion.cosine * [1, 1, 1, 0, 0, 0])
    fit = fit_of(record(rng, arm, still, seconds=60.0))
    said = " ".join(fit.undetermined)
    for joint in (4, 5, 6):
        assert f"joint {joint} moved by 0.00 deg only" in said
    assert "joint 1 moved" not in said
    assert fit.undetermined[0].startswith("these motions determine ")
    assert rms_mm(fit) < 0.1


def test_recordings_that_tell_nothing_are_refused(case):
    recording = case[2]
    points, joints = recording.points, recording.joints
    cases = {
        "joints are at rest": replace(
            recording, joints=replace(joints, q=np.tile(joints.q[0], (len(joints.q), 1)), qd=None)
        ),
        "points are at rest": replace(
            recording, points=replace(points, p_M=np.tile(points.p_M[0], (len(points.p_M), 1)))
        ),
        "wherever its base is": replace(recording, points=replace(points, p_M=points.p_M * 1e3)),
    }
    for words, bad in cases.items():
        with pytest.raises(InputError, match=words):
            fit_of(bad)
    with pytest.raises(InputError, match="6 joints, but the arm has 7"):
        fit_of(recording, nominal=SEVEN)
    short = Recording(
        name="short",
        arm="left",
        joints=replace(joints, time_s=joints.time_s[:200], q=joints.q[:200], qd=None),
        points=replace(points, time_s=points.time_s[-200:], p_M=points.p_M[-200:]),
    )
    with pytest.raises(InputError, match="no 5 s in common"):
        fit_of(short)
    arm, _, _ = case
    rng = np.random.default_rng(16)
    other = record(rng, arm, sweep(rng, 6))
    with pytest.raises(InputError, match="of another time"):
        fit_of(replace(recording, points=other.points))


@pytest.mark.parametrize("seed", [21, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (22, 23))])
def test_short_recordings_of_one_arm_with_errors_of_their_own_fit_alike_beside_a_bad_one(seed):
    """What the model lacks is the same for all: none is followed at the cost of the others."""
    rng = np.random.default_rng(seed)
    arm = replace(true_arm(rng, SEVEN), cycles=2.0, amplitude=np.full(7, 3e-4), phase=rng.uniform(-np.pi, np.pi, 7))
    recordings = []
    for number in range(10):
        motion = sweep(rng, 7, base_hz=1.0 / 70.0, harmonics=12)
        seconds, offset, hz = rng.uniform(10.0, 30.0), rng.uniform(-5.0, 5.0), rng.choice([60.0, 250.0])
        recordings.append(
            record(rng, arm, motion, seconds=seconds, point_hz=hz, offset=offset, name=f"{number}", with_speeds=False)
        )
    bad = recordings[4].points
    phase = (bad.time_s - bad.time_s[0])[:, None] / np.array([3.0, 4.0, 5.0])
    recordings[4] = replace(recordings[4], points=replace(bad, p_M=bad.p_M + 2e-3 * np.sin(phase)))
    fit = fit_of(*recordings, nominal=SEVEN)
    found = dict(fit.recordings)
    (of_the_bad_one,) = (sentence for sentence in fit.undetermined if "other recordings agree to" in sentence)
    assert of_the_bad_one.startswith("recording '4': ")
    assert len(fit.undetermined) == 1
    spoilt = found.pop("4")
    scatter = np.array([one.result.scatter_mm for one in found.values()])
    assert scatter.max() < 2.5 * np.median(scatter)
    assert spoilt.result.scatter_mm > 5.0 * np.median(scatter)
    assert sum(one.result.gross for one in found.values()) < 0.02 * sum(one.result.learnt for one in found.values())


def test_an_arm_of_which_one_joint_moves_is_fitted_and_the_sentence_says_what_it_is_worth(case):
    arm, motion, _ = case
    alone = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    still = replace(motion, sine=motion.sine * alone, cosine=motion.cosine * alone)
    fit = fit_of(record(np.random.default_rng(17), arm, still, seconds=40.0, with_speeds=False))
    assert "predictions hold near them only" in fit.undetermined[0]
    assert sum("moved by 0.00 deg only" in sentence for sentence in fit.undetermined) == 5
    assert rms_mm(fit) < 0.12


def test_an_arm_of_another_type_is_doubted(case):
    arm, motion, _ = case
    longer = UR10.copy()
    longer[2, 2] += 0.06
    recording = record(np.random.default_rng(18), arm, motion, seconds=40.0)
    other = RecordedArm(nominal_geometry(longer, np.zeros(3)), [recording], tool_unknown=True)
    assert identify_from_motion(other).undetermined[0].startswith("whether it is an arm of this type: the published")
    assert not any("type" in said for said in fit_of(recording).undetermined)


def test_from_values_that_are_far_off_no_recording_fits_worse_than_there_and_too_few_steps_are_an_error(
    case, monkeypatch
):
    recording = case[2]
    problem = motion_problem(
        RecordedArm(nominal_geometry(UR10, np.zeros(3)), [recording], tool_unknown=True), ignore_words
    )
    near = solve(problem)
    far = near.values.copy()
    base = [problem.parameters.names.index(name) for name in ("x0", "y0", "z0", "alpha0", "beta0", "theta0")]
    far[base] += [0.3, -0.2, 0.2, 0.6, -0.5, 0.6]

    def square(values):
        return float(np.sum(residuals(problem, values, 0, near.sources[0].rows) ** 2))

    values = solve(problem, far).values
    assert square(values) <= square(far)
    monkeypatch.setattr("cellapp.estimation.motion.fit._STEPS", 1)
    with pytest.raises(NotConverged, match="fit of recordings of motion did not converge: 1 steps were not enough"):
        solve(problem, far)
