"""What happens over time: a measurement that is broken, warmth, sweeps on record."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.planning.plan import plan_stops
from cellapp.cell.profile import load_profile
from drivers.arms.simulated import SimulatedArm
from drivers.plant import Plant
from drivers.plant.mechanism import TrueBodies, inertia_torques
from drivers.plant.servo import LOOKAHEAD_S
from drivers.plant.sweep import Recorder, SweepRecord, record_sweep, recorder_of
from drivers.trackers.protocol import TargetLost, TrackerLinkLost
from drivers.trackers.simulated import SimulatedTracker
from tests.twin import PROFILES, small_twin

# -- Scheduled actions happen at their time, in the middle of what a device does ---------------------------------------

SLOW = np.full(6, 0.5)


@pytest.fixture
def plant() -> Plant:
    return build_plant(small_twin())


def test_what_happens_during_a_measurement_breaks_it(plant: Plant) -> None:
    tracker = SimulatedTracker(plant)
    tracker.connect()
    profile = load_profile(PROFILES / "twin.yaml")
    q = plan_stops(small_twin(2))
    arm = SimulatedArm(plant, "left")
    arm.connect()
    arm.start_move(q["left"][0], SLOW, SLOW)
    arm.wait_settled(60.0)
    target = next(target for target in plant.targets() if target.arm == "left")
    assert tracker.measure(target.p_M, profile.tracker.averaging).averaging_s == 1.0
    plant.schedule.at(plant.clock_s + 1.0, lambda: tracker.covered.add("left"))
    with pytest.raises(TargetLost, match="broke in mid-measurement"):
        tracker.measure(target.p_M, 1.0)
    tracker.covered.clear()
    plant.schedule.at(plant.clock_s + 1.0, tracker.cut_link)
    with pytest.raises(TrackerLinkLost):
        tracker.measure(target.p_M, 1.0)


# -- warmth ------------------------------------------------------------------------------------------------------------


def test_a_given_history_agrees_with_a_simulated_one(make_arm, make_plant):
    values = {"expansion": 23e-6, "share": 0.8, "lag": 900.0, "motor": 1e-6}
    lived = make_plant(make_arm(effects={"thermal_growth": values}), holding_k=10.0)
    told = make_plant(make_arm(effects={"thermal_growth": values}), holding_k=10.0)
    q, seen, time_s, air_c, joints_c = lived.q("left"), [], [], [], []
    for _ in range(60):
        time_s.append(lived.clock_s)
        air_c.append(lived.air_c)
        joints_c.append(lived.joints_c("left"))
        seen.append(lived.targets()[0].p_M)
        lived.advance(60.0)
    found = told.smr_positions(
        "left", np.tile(q, (60, 1)), time_s=np.array(time_s), air_c=np.array(air_c), joints_c=np.array(joints_c)
    )
    growth = np.linalg.norm(found[-1] - found[0])
    assert growth > 50e-6
    assert np.abs(found - np.array(seen)).max() < 0.02 * growth


# -- A sweep on record: lag of the joints, play along the path, two clocks, samples and beams that are lost ------------


CYCLE_S = 0.008
EXACT = Recorder(lost_samples=0.0, jitter_s=0.0, lost_beams_per_min=0.0)


def plant_with(effects: dict[str, dict[str, object]]) -> Plant:
    quiet = {"effects": {"left": effects, "right": {}}, "noise": False, "repeatability": 0.0}
    return build_plant(small_twin(plant=quiet))


def swing(plant: Plant, seconds: float = 8.0, joint: int = 0, reach: float = 0.2) -> np.ndarray:
    """Commands of one joint that swings forth and back twice, from rest to rest."""
    time_s = np.arange(0.0, seconds, CYCLE_S)
    q = np.repeat(plant.q("left")[None], len(time_s), axis=0)
    q[:, joint] += reach * np.sin(np.pi * time_s / seconds) ** 2 * np.sin(4.0 * np.pi * time_s / seconds)
    return q


def at_points(record: SweepRecord, recorder: Recorder) -> np.ndarray:
    """Joint positions at the times of the points, by the clocks as they are."""
    time_s = (record.point_time_s - recorder.offset_s) / (1.0 + 1e-6 * recorder.rate_ppm)
    return np.column_stack([np.interp(time_s, record.joint_time_s, column) for column in record.q.T])


def test_joints_lag_behind_their_commands_and_rest_at_both_ends() -> None:
    plant = plant_with({})
    commanded = swing(plant)
    record = record_sweep(plant, EXACT, "left", commanded, CYCLE_S)
    time_s = record.joint_time_s - record.joint_time_s[0]
    np.testing.assert_allclose(record.q[0], commanded[0], atol=1e-9)
    np.testing.assert_allclose(record.q[-1], commanded[-1], atol=1e-4)
    delays = np.arange(0.0, 0.1, 0.001)
    at = np.arange(len(commanded)) * CYCLE_S + 0.5
    misses = [np.abs(np.interp(time_s - d, at, commanded[:, 0]) - record.q[:, 0]).max() for d in delays]
    assert delays[int(np.argmin(misses))] == pytest.approx(LOOKAHEAD_S, abs=0.005)
    np.testing.assert_allclose(np.gradient(record.q[:, 0], time_s), record.qd[:, 0], atol=2e-3)


def test_inertia_is_that_of_virtual_work():
    mechanism, rng, h = plant_with({}).true_mechanism("left"), np.random.default_rng(1), 1e-3
    q, qd, qdd = rng.uniform(-1.0, 1.0, (3, 5, 6))
    before, after = (q + sign * h * qd + 0.5 * h * h * qdd for sign in (-1.0, 1.0))
    centers = [TrueBodies.at(mechanism, at).centers for at in (before, q, after)]
    acceleration = (centers[0] - 2.0 * centers[1] + centers[2]) / h**2
    found = inertia_torques(mechanism, before, q, after, h)
    masses = TrueBodies.at(mechanism, q).masses
    for joint in range(6):
        by = 1e-5 * np.eye(6)[joint]
        moved = (TrueBodies.at(mechanism, q + by).centers - TrueBodies.at(mechanism, q - by).centers) / 2e-5
        work = -np.einsum("k,knx,knx->n", masses, acceleration, moved)
        own = TrueBodies.at(mechanism, q).own[joint] * qdd[:, joint]
        np.testing.assert_allclose(found[:, joint], work - own, atol=1e-4)


def struck(plant: Plant) -> SweepRecord:
    """A joint that is accelerated all at once, and rests after half a second."""
    time_s = np.arange(0.0, 4.0, CYCLE_S)
    q = np.repeat(plant.q("left")[None], len(time_s), axis=0)
    q[:, 1] += 0.05 * np.clip(time_s, 0.0, 0.5)
    return record_sweep(plant, EXACT, "left", q, CYCLE_S)


def test_a_struck_arm_swings_at_its_natural_frequency_and_comes_to_rest():
    stiffness = [9e4, 6e4, 3.5e4, 1.2e4, 1.2e4, 1.2e4]
    plant = plant_with({"joint_vibration": {"stiffness": stiffness, "damping": 0.04}})
    mass = TrueBodies.at(plant.true_mechanism("left"), plant.q("left")[None]).mass_matrix(0)
    first_hz = np.sqrt(eigh(np.diag(stiffness), mass, eigvals_only=True)[0]) / (2.0 * np.pi)
    record = struck(plant)
    still = record.joint_time_s[-1] - 3.0  # the command ended half a second before
    rests = record.point_time_s > still
    moved = record.p_M[rests] - record.p_M[-20:].mean(axis=0)
    along = moved @ np.linalg.svd(moved, full_matrices=False)[2][0]
    power = np.abs(np.fft.rfft(along, 8192))
    frequency = np.fft.rfftfreq(8192, 1.0 / EXACT.point_hz)
    assert frequency[np.argmax(power)] == pytest.approx(first_hz, rel=0.05)
    assert np.abs(along[:50]).max() > 5e-6
    assert np.abs(along[-50:]).max() < 0.05 * np.abs(along[:50]).max()


def test_a_late_drive_follows_by_its_time_constant_and_delay():
    plant = plant_with({"drive_lag": {"time_constant": [0.02] * 6, "delay": [0.0, 0.01, 0.0, 0.0, 0.0, 0.0]}})
    for joint, late_s in ((0, 0.0225), (1, 0.0325)):
        record = record_sweep(plant, EXACT, "left", swing(plant, joint=joint), CYCLE_S)
        q = at_points(record, EXACT)
        delayed = np.column_stack([np.interp(record.point_time_s - late_s, record.point_time_s, c) for c in q.T])
        miss = np.linalg.norm(record.p_M - plant.smr_positions("left", delayed), axis=1)
        assert miss.max() < 0.2 * np.linalg.norm(record.p_M - plant.smr_positions("left", q), axis=1).max()


def test_play_lags_behind_each_reversal_by_its_width() -> None:
    play = 2e-4
    plant = plant_with({"backlash": {"play": [play, 0.0, 0.0, 0.0, 0.0, 0.0]}})
    record = record_sweep(plant, EXACT, "left", swing(plant), CYCLE_S)
    q = at_points(record, EXACT)
    signs = (np.tile([sign, 0, 0, 0, 0, 0], (len(q), 1)) for sign in (1, -1))
    forth, back = (plant.smr_positions("left", q, approach=sign) for sign in signs)
    loop = np.linalg.norm(forth - back, axis=1)
    speed = np.gradient(q[:, 0])
    crossed = np.convolve(np.abs(speed), np.ones(100), mode="same") > 3.0 * play
    for way, expected in ((speed > 2e-5, forth), (speed < -2e-5, back)):
        late = way & crossed & np.roll(way, 60) & np.roll(way, 30)
        assert late.sum() > 100
        assert np.abs(record.p_M[late] - expected[late]).max() < 0.1 * loop.max()


def test_clocks_differ_as_stated_and_losses_are_gaps() -> None:
    plant = plant_with({})
    recorder = Recorder(offset_s=12.0, rate_ppm=1000.0, lost_samples=0.1, lost_beams_per_min=60.0, seed=3)
    commanded = swing(plant)
    record = record_sweep(plant, recorder, "left", commanded, CYCLE_S)
    assert 0.05 < 1.0 - len(record.joint_time_s) / (9.0 * 125.0) < 0.2
    lost = np.isnan(record.p_M).any(axis=1)
    assert 0.0 < lost.mean() < 1.0
    np.testing.assert_allclose(np.diff(record.point_time_s), 1.001 / recorder.point_hz, rtol=1e-9)
    seen = ~lost
    expected = plant.smr_positions("left", at_points(record, recorder)[seen])
    np.testing.assert_allclose(record.p_M[seen], expected, atol=5e-5)
    assert recorder_of(plant) == recorder_of(plant_with({}))


def test_a_sweep_that_begins_elsewhere_or_meets_a_motion_is_refused() -> None:
    plant = plant_with({})
    with pytest.raises(ValueError, match="not where its sweep begins"):
        record_sweep(plant, EXACT, "left", swing(plant) + 0.1, CYCLE_S)
    plant.start_move("right", plant.q("right") + 0.1, np.ones(6), np.ones(6))
    with pytest.raises(ValueError, match="no other motion"):
        record_sweep(plant, EXACT, "left", swing(plant), CYCLE_S)
